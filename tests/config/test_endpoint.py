"""A bus that strangers can reach is refused to every process, not by ``run`` and ``check`` alone."""

import os
import re
import socket
import stat
from pathlib import Path

import pytest

from robofleet.bus.endpoint import check_free, settled
from robofleet.bus.private_folder import PlaceError, private_folder
from robofleet.config.files.robot_file import load_robot_file
from robofleet.config.load import ConfigError, load_config
from robofleet.config.tree import Config
from tests.endpoints import short_folder
from tests.shipped import PLATOON

LOOPBACK = ["tcp/127.0.0.1:7447", "tcp/127.0.0.2:65535", "tcp/[::1]:7447", "tcp/localhost:0"]
SOCKET = "unixsock-stream//run/lab/bus.sock"


def of(endpoint: str, *more: str) -> Config:
    return load_config(PLATOON, [f"bus.endpoint={endpoint}", *more])


@pytest.fixture
def runtime(monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = short_folder()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder))
    return folder


@pytest.mark.parametrize("endpoint", LOOPBACK)
def test_loopback_is_every_users_and_must_be_asked_for(endpoint: str, tmp_path: Path) -> None:
    file = tmp_path / "lab.yaml"
    file.write_text(f"bus: {{endpoint: '{endpoint}'}}\n{PLATOON.read_text()}")
    with pytest.raises(ConfigError, match=r"lab\.yaml:1:17: bus\.endpoint: .*every user.*insecure: loopback"):
        load_config(file)
    assert of(endpoint, "bus.insecure=loopback").bus.endpoint == endpoint


@pytest.mark.parametrize("address", ["192.168.1.10:7447", "tls/lab", "tcp/192.168.1.10:7447", "{}", ""])
def test_what_is_no_address_for_other_hosts_is_refused(address: str, tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(f"arena: lab\nunit: r1\nrouter: ['{address}']\n")
    for load in lambda: load_config(PLATOON, [f"bus.listen=['{address}']"]), lambda: load_robot_file(file):
        with pytest.raises(ConfigError, match="must look like tls/192"):
            load()


@pytest.mark.parametrize(("length", "taken"), [(107, True), (108, False)])
def test_a_sockets_path_has_107_bytes_at_most(length: int, taken: bool, runtime: Path) -> None:
    endpoint = "unixsock-stream//run/".ljust(length + len("unixsock-stream/"), "x")
    if taken:
        assert of(endpoint).bus.endpoint == endpoint
    else:
        with pytest.raises(ConfigError, match=r"bus\.endpoint: the path has 108 bytes, a socket's at most 107"):
            of(endpoint)


def test_who_has_the_same_configuration_meets_at_a_socket_of_this_user_named_after_the_arena(runtime: Path) -> None:
    config = load_config(PLATOON)
    met = {settled(config, listen=listen).bus.endpoint for listen in (False, True)}
    assert met == {f"unixsock-stream/{runtime}/robofleet/platoon.sock"}
    assert stat.S_IMODE((runtime / "robofleet").stat().st_mode) == 0o700
    other = settled(load_config(PLATOON, ["arena.name=hall"]), listen=True)
    assert other.bus.endpoint.endswith("/robofleet/hall.sock")
    assert load_config(PLATOON, [f"bus.endpoint={other.bus.endpoint}"]).bus.endpoint == other.bus.endpoint


def test_a_folder_whose_name_is_too_long_for_a_socket_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    folder = short_folder() / ("x" * 100)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder))
    with pytest.raises(PlaceError, match=rf"bus\.endpoint: .*{folder}.* may have 107: set XDG_RUNTIME_DIR"):
        settled(load_config(PLATOON), listen=True)


def test_a_router_that_was_killed_leaves_its_place_free_and_a_living_one_does_not(runtime: Path) -> None:
    config = settled(load_config(PLATOON), listen=True)
    check_free(config)
    path = config.bus.endpoint.partition("/")[2]
    with socket.socket(socket.AF_UNIX) as served:
        served.bind(path)
        served.listen()
        with pytest.raises(PlaceError, match=r"bus\.endpoint: .*in use.*: end the run that has it"):
            check_free(config)
    check_free(config)
    Path(path).unlink()
    Path(path).write_text("precious")
    with pytest.raises(PlaceError, match="is not a socket"):
        check_free(config)
    assert Path(path).read_text() == "precious"


def spoil(folder: Path, how: str) -> None:
    if how == "a link":
        (folder.parent / "victim").mkdir(mode=0o700)
        folder.symlink_to(folder.parent / "victim")
    elif how == "a dangling link":
        folder.symlink_to(folder.parent / "nowhere")
    elif how == "a file":
        folder.write_text("")
    else:
        folder.mkdir()
        folder.chmod(0o777)


@pytest.mark.parametrize("how", ["a link", "a dangling link", "a file", "open to others"])
@pytest.mark.parametrize("given", ["runtime", "temporary"])
def test_a_folder_that_others_may_reach_is_refused(how: str, given: str, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = short_folder()
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR" if given == "runtime" else "TMPDIR", str(folder))
    spoil(folder / ("robofleet" if given == "runtime" else f"robofleet-{os.geteuid()}"), how)
    cure = "chmod 700" if how == "open to others" else "remove it, or set XDG_RUNTIME_DIR"
    with pytest.raises(PlaceError, match=rf"{re.escape(str(folder))}/robofleet.*: .*{cure}"):
        private_folder()
    with pytest.raises(PlaceError, match=r"bus\.endpoint: "):
        settled(load_config(PLATOON), listen=False)


def test_the_folder_of_a_socket_that_is_named_must_be_this_users_too() -> None:
    folder = short_folder() / "run"
    with pytest.raises(PlaceError, match="mkdir -m 700"):
        settled(of(f"unixsock-stream/{folder}/bus.sock"), listen=False)
    folder.mkdir()
    folder.chmod(0o755)
    with pytest.raises(PlaceError, match="chmod 700"):
        settled(of(f"unixsock-stream/{folder}/bus.sock"), listen=False)


@pytest.mark.parametrize("below", ["", "deeper"])
def test_a_runtime_folder_that_is_a_file_is_named(below: str, monkeypatch: pytest.MonkeyPatch) -> None:
    file = short_folder() / "file"
    file.write_text("")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(file / below))
    with pytest.raises(PlaceError, match=rf"{file}.*Not a directory: set XDG_RUNTIME_DIR to a folder of yours"):
        private_folder()
