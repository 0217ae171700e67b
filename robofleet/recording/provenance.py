"""Where a recording comes from: versions, machine and configuration, kept in the file as its metadata."""

import platform
from dataclasses import dataclass
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from operator import attrgetter
from pathlib import Path
from typing import Any

from robofleet.bus.layouts import VERSION
from robofleet.config.load import resolved_yaml
from robofleet.config.slices import build
from robofleet.config.tree import Config
from robofleet.core.settings import Model

_PACKAGES = {
    "robofleet": "robofleet",
    "numpy": "numpy",
    "numba": "numba",
    "opencv": "opencv-python-headless",
    "zenoh": "eclipse-zenoh",
    "onnxruntime": "onnxruntime",
}
_CPU_INFO = Path("/proc/cpuinfo")
_COUNTS, _TEXTS = ("epoch_ns", "wire", "build"), ("mode", "architecture", "processor")
_VERSION_OF, _SHA256_OF = "version of ", "sha256 of "


@dataclass(frozen=True)
class Provenance:
    """What made a recording."""

    mode: str  # lockstep or realtime
    epoch_ns: int  # what makes the recording's times dates [ns since 1970]; 0 in lockstep: its times are no dates
    wire: int  # version of the messages
    build: int  # config.slices.build
    architecture: str
    processor: str
    versions: dict[str, str]
    hashes: dict[str, str]  # sha256 of the configuration, and of what was measured: by its place in there

    @classmethod
    def here(cls, config: Config, mode: str, epoch_ns: int = 0) -> "Provenance":
        """Return what a recording would say that is made now, on this machine."""
        versions = {"python": platform.python_version()} | {
            name: _version(package) for name, package in _PACKAGES.items()
        }
        return cls(mode, epoch_ns, VERSION, build(config), platform.machine(), _processor(), versions, _hashes(config))

    @classmethod
    def of(cls, metadata: dict[str, str]) -> "Provenance":
        """Return what a file's metadata say; KeyError or ValueError where they do not."""
        values: dict[str, Any] = {name: metadata[name] for name in _TEXTS}
        values |= {name: _count(metadata[name]) for name in _COUNTS}
        return cls(**values, versions=_those(metadata, _VERSION_OF), hashes=_those(metadata, _SHA256_OF))

    def metadata(self) -> dict[str, str]:
        return {
            **{name: str(getattr(self, name)) for name in ("mode", *_COUNTS, "architecture", "processor")},
            **{_VERSION_OF + name: value for name, value in self.versions.items()},
            **{_SHA256_OF + name: value for name, value in self.hashes.items()},
        }

    def same_machine(self, other: "Provenance") -> bool:
        """Return whether the same input must give the same bits in both: equal versions on equal processors."""
        computed_with = attrgetter("wire", "architecture", "processor")
        both = self.versions.keys() & other.versions.keys()  # what an older recording says nothing of, it did without
        return bool(computed_with(self) == computed_with(other)) and all(
            self.versions[name] == other.versions[name] for name in both
        )


def _count(text: str) -> int:
    count = int(text)
    if not 0 <= count < 1 << 62:
        raise ValueError("no instant and no count of this century's")
    return count


def _those(metadata: dict[str, str], prefix: str) -> dict[str, str]:
    return {name.removeprefix(prefix): value for name, value in metadata.items() if name.startswith(prefix)}


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def _processor() -> str:
    """Return the processor's model: what numba compiles for."""
    try:
        lines = _CPU_INFO.read_text().splitlines()
    except OSError:
        lines = []
    models = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(models, platform.processor())


def _hashes(config: Config) -> dict[str, str]:
    measured: dict[str, Model | None] = {f"{path}.model": camera.model for path, camera in config.camera_keys}
    measured |= {f"robots.{k}.calibration": robot.calibration for k, robot in enumerate(config.robots)}
    texts = {name: model.model_dump_json() for name, model in measured.items() if model is not None}
    texts["config.yaml"] = resolved_yaml(config)
    return {name: sha256(text.encode()).hexdigest() for name, text in texts.items()}
