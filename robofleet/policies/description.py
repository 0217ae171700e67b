"""A policy's two files: the network as ONNX, and beside it what the network observes, as JSON of the same name.

A resolved configuration names the network together with what is in both files: ``/lab/go_to.onnx#sha256=...``. So a
recording is replayed by the same policy or by none.
"""

import json
import os
from collections.abc import Sequence
from contextlib import suppress
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Final, Literal, NamedTuple, Self

from pydantic import Field, JsonValue, PlainSerializer, ValidationError, model_validator

from robofleet.core.arrays import Array
from robofleet.core.errors import BadInputError
from robofleet.core.files import read_named, write_bytes
from robofleet.core.plugins import PluginError, known
from robofleet.core.settings import MANY, ROBOTS, Lasting, Model, Named, Positive, within
from robofleet.policies.interface import GROUP, Task, Term, load_task

FORMAT: Final = 1
LARGEST_NETWORK_BYTES = 100_000_000
_LARGEST_DESCRIPTION_BYTES = 1 << 20
_SUFFIX, _PIN = ".onnx", "#sha256="

Numbers = Annotated[tuple[Annotated[float, within(-1e9, 1e9)], ...], Field(max_length=MANY)]


class PolicyError(BadInputError, ValueError):
    """Raised where a policy's file cannot be used, or cannot be made. The message is a line: what, and its cure."""


class TaskDescription(Model):
    """The task that was trained for."""

    name: Named
    """An entry point of ``robofleet.tasks``, or ``module:Class``."""
    settings: dict[str, JsonValue] = Field({})
    """As trained; a configuration may give others."""


class Normalisation(Model):
    """What is done to a network's inputs (I): (input - mean) / sqrt(variance + 1e-8), cut off at +- clip."""

    mean: Numbers
    variance: Annotated[tuple[Annotated[float, within(0, 1e18)], ...], Field(max_length=MANY)]
    clip: Positive = 10.0


class Description(Model):
    """What the JSON says."""

    format: Literal[1] = FORMAT
    robofleet: Annotated[str, Field(max_length=100)] = Field(default_factory=lambda: version("robofleet"))
    """Version that wrote it."""
    task: TaskDescription
    terms: Annotated[
        tuple[Annotated[Term, PlainSerializer(Term._asdict)], ...], Field(min_length=1, max_length=MANY, strict=False)
    ]
    """What each robot observes, in the network's order. Each term is divided by its scale, then normalised."""
    normalisation: Normalisation | None = None
    form: Literal["robot", "group"] = "robot"
    """``robot``: the network (B, F) -> (B, 2) has a row for each robot. ``group``: (B, N F) -> (B, 2 N) decides for all
    robots of a group at once, in the group's order."""
    robots: Annotated[int, within(1, ROBOTS)] | None = None
    """N. Without it any number."""
    tick_s: Lasting
    """Control step."""
    action: Literal["share_of_top_speeds"] = "share_of_top_speeds"
    """What actions are: v and omega of a robot as shares of its own top speeds, straight on and on the spot."""

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if self.form == "group" and self.robots is None:
            raise ValueError("a network of the form group needs the number of robots")
        n = self.normalisation
        if n is not None and not len(n.mean) == len(n.variance) == self.inputs:
            raise ValueError(f"mean and variance need {self.inputs} numbers each, one for each input of the network")
        return self

    @property
    def inputs(self) -> int:
        """How many numbers a row of the network's input has."""
        return self._of_group * sum(term.size for term in self.terms)

    @property
    def outputs(self) -> int:
        """How many numbers a row of the network's output has."""
        return self._of_group * 2

    @property
    def _of_group(self) -> int:
        return (self.robots or 1) if self.form == "group" else 1


class Contents(NamedTuple):
    """What is in both files."""

    network: bytes
    description: Description
    sha256: str


def described(
    task: Task, *, form: Literal["robot", "group"] = "robot", robots: int | None = None,
    mean: Sequence[float] | Array | None = None, variance: Sequence[float] | Array | None = None, clip: float = 10.0,
) -> Description:  # fmt: skip
    """Describe what a network observes that was trained for a task.

    Args:
        task: As it was trained for, of its environment or of ``load_task``.
        form: ``robot``: a row for each robot; ``group``: a row for all robots.
        robots: How many robots it is for. None: any number of the form ``robot``; as trained of the form ``group``.
        mean: Of the inputs, if they were normalised: as many as a row has.
        variance: Of the inputs, too.
        clip: Normalised inputs were cut off there.

    Returns:
        The description, for ``save_policy``.

    Raises:
        PolicyError: The task stands in the script that runs, or the sizes do not fit.
    """
    given = {
        "task": {"name": _name_of(type(task)), "settings": task.settings.model_dump(mode="json")},
        "terms": tuple(task.terms),
        "normalisation": None if mean is None or variance is None else {
            "mean": tuple(map(float, mean)), "variance": tuple(map(float, variance)), "clip": clip,
        },
        "form": form, "robots": len(task.team) if form == "group" and robots is None else robots,
        "tick_s": task.team.tick,
    }  # fmt: skip
    try:
        return Description.model_validate(given)
    except ValidationError as error:
        raise PolicyError(f"this policy cannot be described: {_first(error)}") from error


def save_policy(file: Path, network: bytes, description: Description) -> None:
    """Write a policy's two files.

    Args:
        file: Of the network; it ends in .onnx.
        network: As ONNX, with all weights in it.
        description: What it observes.

    Raises:
        PolicyError: The files cannot be written.
    """
    if file.suffix != _SUFFIX:
        raise PolicyError(f"{file}: a policy's file ends in {_SUFFIX}: name it so")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        write_bytes(file, network)
        write_bytes(beside(file), (json.dumps(description.model_dump(mode="json"), indent=1) + "\n").encode())
    except OSError as error:
        raise PolicyError(f"{error.filename or file}: cannot be written: {error.strerror}") from error


def read_policy(name: str | Path) -> Contents:
    """Read a policy's two files by the network's name, pinned or not.

    PolicyError where one is missing, too large, not what it should be, or not what it was when the name was pinned.
    """
    file, digest = split(str(name))
    if digest and not _there(file):
        raise PolicyError(f"{file}: is gone: put it back; `robofleet replay` finds it by `--behaviours DIR`, too")
    if file.suffix != _SUFFIX:
        raise PolicyError(f"{file}: a policy's file ends in {_SUFFIX}: name the network")
    network = _read(file, LARGEST_NETWORK_BYTES, "mend its name")
    text = _read(beside(file), _LARGEST_DESCRIPTION_BYTES, "a policy's JSON stands beside it: copy both files")
    found = sha256(sha256(network).digest() + sha256(text).digest()).hexdigest()
    if digest not in ("", found):
        raise PolicyError(f"{file}: it or its JSON is not what it was (sha256 {digest[:12]}...): put that policy back")
    return Contents(network, _description(beside(file), text), found)


def beside(file: Path) -> Path:
    """Return the JSON that describes a network."""
    return file.with_suffix(".json")


def pinned(name: str, folder: Path) -> str:
    """Return a policy's absolute path with what is in its files; ``folder``: where a relative name begins.

    A name that is pinned stays so; where its file is gone, one of the same name in the folder takes its place.
    """
    path, digest = split(name)
    if not digest:
        file = (folder / path).absolute()
        return f"{file}{_PIN}{read_policy(file).sha256}"
    if not _there(path) and _there(moved := (folder / path.name).absolute()):
        return f"{moved}{_PIN}{digest}"
    return name


def split(name: str) -> tuple[Path, str]:
    """Return the path and the digest of a pinned name; no digest: it is not pinned."""
    path, _, digest = name.partition(_PIN)
    return Path(path), digest


def _there(file: Path) -> bool:
    return os.path.exists(file)  # noqa: PTH110 - it raises nothing


def _read(file: Path, most: int, mend: str) -> bytes:
    try:
        if file.stat().st_size > most:  # a network of a gigabyte is not read first
            raise PolicyError(f"{file}: has {file.stat().st_size:,} bytes, and a policy's may have {most:,} at most")
        return read_named(file, most)
    except FileNotFoundError as error:
        raise PolicyError(f"{file}: there is no such file: {mend}") from error
    except OSError as error:
        raise PolicyError(f"{file}: cannot be read: {error.strerror}: {mend}") from error


def _description(file: Path, text: bytes) -> Description:
    try:
        plain = json.loads(text)
    except ValueError as error:
        raise PolicyError(f"{file}: is no JSON: write it by `save_policy`") from error
    if not isinstance(plain, dict) or "format" not in plain:
        raise PolicyError(f"{file}: does not describe a policy: write it by `save_policy`")
    if plain["format"] != FORMAT:
        raise PolicyError(
            f"{file}: is of format {plain['format']}, and this robofleet ({version('robofleet')}) reads {FORMAT}: "
            f"install robofleet {plain.get('robofleet', 'that wrote it')}"
        )
    try:
        return Description.model_validate_json(text)
    except ValidationError as error:
        raise PolicyError(f"{file}: {_first(error)}: write it by `save_policy`") from error


def _first(error: ValidationError) -> str:
    fault = error.errors(include_url=False)[0]
    where = ".".join(map(str, fault["loc"]))
    return f"{where}: {fault['msg']}" if where else fault["msg"].removeprefix("Value error, ")


def _name_of(task: type[Task]) -> str:
    for name in known(GROUP):
        with suppress(PluginError):  # of another package, which is broken
            if load_task(name) is task:
                return name
    if task.__module__ == "__main__":
        raise PolicyError(
            f"the task {task.__name__} stands in the script that runs, where no run finds it: put it in a file of its "
            "own beside the policy, and import it"
        )
    return f"{task.__module__}:{task.__qualname__}"
