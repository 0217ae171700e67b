"""Each check of the drivers' contract notices the driver that breaks it, and no other check does."""

import inspect
from collections.abc import Iterator
from itertools import product
from typing import Any

import pytest

from robofleet.testing import DriverContract, DriverSubject
from tests.drivers import broken
from tests.drivers.sparrow import Sparrow  # type: ignore[attr-defined]

pytestmark = pytest.mark.slow

# Which checks notice what is broken; the first is the one that it is made for.
NOTICED = {
    "Reversed": ["test_each_wheel_turns_as_it_is_told"],
    "Swapped": ["test_each_wheel_turns_as_it_is_told"],
    "CoarselyRounded": ["test_each_wheel_turns_as_it_is_told"],
    "CountsBackwards": ["test_the_angles_that_it_reads_are_those_that_the_wheels_turned"],
    "DegreesPerSecond": ["test_the_speeds_that_it_reads_are_those_of_the_wheels"],
    "TellsWhatNobodyAsked": ["test_it_tells_of_its_sensors_where_it_is_asked"],
    "BatteryInVolts": ["test_a_robot_in_health_says_so"],
    "MovesWhenMade": ["test_it_stands_until_it_is_told_to_move"],
    "RoundsUpAtTheLimit": ["test_it_never_turns_faster_than_it_may"],
    "SaysItAgain": ["test_it_stops_by_itself_when_it_is_told_nothing_more"],
    "LeavesItTurning": ["test_it_stands_when_it_was_closed"],
    "WritesWhenClosed": ["test_nothing_is_written_after_it_was_closed"],
    "WritesToItsOldNumber": ["test_nothing_is_written_after_it_was_closed"],
    "BelievesEveryLine": ["test_bad_lines_are_borne"],
    "MiscountsBadLines": ["test_bad_lines_are_borne"],
    "NeverMissesIt": ["test_a_robot_that_does_not_answer_is_an_error_and_stands_when_it_does_again"],
    "WritesIntoTheVoid": ["test_a_plug_that_is_pulled_out_is_an_error_at_the_next_word"],
    "ReadsFromTheVoid": ["test_a_plug_that_is_pulled_out_is_an_error_at_the_next_word"],
    "SeesNoPlug": [
        "test_the_status_says_within_100_ms_that_the_plug_was_pulled_out",
        "test_a_plug_that_is_pulled_out_is_an_error_at_the_next_word",
    ],
    "ComesBackOnce": ["test_a_robot_that_is_plugged_in_again_stands_and_drives_again"],
    "GoesOn": ["test_a_robot_that_is_plugged_in_again_stands_and_drives_again"],
    "GreetsWithoutAStop": ["test_a_robot_that_turns_when_its_line_is_opened_stands_when_it_has_been"],
    "WaitsForRoom": ["test_a_robot_that_takes_nothing_keeps_nobody_waiting"],
    "WaitsForAnAnswer": ["test_a_robot_that_takes_nothing_keeps_nobody_waiting"],
    "TakesAnySetting": ["test_a_setting_that_there_is_not_is_refused_in_words"],
    "GuessesItsPort": ["test_a_port_that_is_not_given_is_refused_in_words"],
    "TakesAnyNumber": ["test_a_setting_that_cannot_be_is_refused"],
    "NamelessWhenAbsent": ["test_a_port_that_is_absent_is_named"],
    "NamelessWhenBusy": ["test_a_port_that_somebody_has_is_named_and_left_alone"],
    "SharesItsBoard": ["test_those_that_say_so_may_be_constructed_at_once"],
    "MeetsAnybody": ["test_who_speaks_another_language_is_no_robot_of_ours_and_does_not_move"],
    "ShoutsAround": ["test_who_speaks_another_language_is_no_robot_of_ours_and_does_not_move"],
    "ClosesOnce": ["test_closing_again_is_fine_and_so_is_closing_without_a_line"],
    "MadeTwiceAtMost": ["test_one_that_was_closed_can_be_made_again_on_its_port"],
    "Spins": ["test_it_does_not_keep_the_processor_busy", "test_a_robot_that_takes_nothing_keeps_nobody_waiting"],
    "LeavesADescriptor": [
        "test_nothing_is_left_of_those_that_were_closed",
        "test_nothing_is_left_of_a_hundred_that_were_closed",
    ],
    "LeavesADescriptorWhenRefused": ["test_nothing_is_left_of_those_that_could_not_be_made"],
    "RemembersEverything": ["test_its_memory_does_not_grow", "test_its_memory_does_not_grow_in_an_hour"],
}


def contract(driver: str) -> Any:
    """Return the checks of one of the broken drivers."""
    subject = DriverSubject(f"tests.drivers.broken:{driver}", twin="tests.drivers.sparrow:SparrowFirmware")
    return type("Broken", (DriverContract,), {"subject": subject})()


def checks() -> dict[str, Any]:
    return {name: check for name, check in inspect.getmembers(DriverContract, callable) if name.startswith("test_")}


def slow(check: str) -> bool:
    return any(mark.name == "long" for mark in getattr(checks()[check], "pytestmark", []))


def cases(check: Any) -> Iterator[dict[str, Any]]:
    """Give the arguments of every case of a check."""
    tables = [mark.args for mark in getattr(check, "pytestmark", []) if mark.name == "parametrize"]
    for row in product(*(values for _, values in tables)):
        yield dict(zip([name for name, _ in tables], row, strict=True))


def notices(driver: str, check: str) -> bool:
    """Whether a check fails, in any of its cases, for what a driver does; an AssertionError or another exception."""
    for case in cases(checks()[check]):
        try:
            getattr(contract(driver), check)(**case)
        except pytest.skip.Exception:
            continue
        except (Exception, pytest.fail.Exception):  # noqa: BLE001 - however it fails, it noticed
            return True
    return False


def test_every_check_and_every_broken_driver_has_its_line() -> None:
    assert {check for noticed in NOTICED.values() for check in noticed} == set(checks())
    kinds = {name for name, kind in vars(broken).items() if isinstance(kind, type) and issubclass(kind, Sparrow)}
    assert set(NOTICED) == kinds - {"Sparrow"}


@pytest.mark.parametrize("driver", NOTICED)
def test_the_check_notices_the_driver_that_breaks_it(driver: str) -> None:
    assert notices(driver, NOTICED[driver][0])


@pytest.mark.long
@pytest.mark.parametrize("driver", NOTICED)
def test_no_other_check_notices_it(driver: str) -> None:
    others = [check for check in checks() if check not in NOTICED[driver] and not slow(check)]
    assert [check for check in others if notices(driver, check)] == []
