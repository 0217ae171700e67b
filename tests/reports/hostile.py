"""Recordings as somebody makes them who means harm: every one is an MCAP file whose checksums are right."""

import json
import zlib
from collections.abc import Iterator, Sequence
from struct import pack

import zstandard
from mcap.records import Attachment, Channel, Chunk, DataEnd, Header, Metadata, Schema
from mcap.writer import MCAP0_MAGIC as MAGIC

from robofleet.bus.keys import TICK, key
from robofleet.bus.layouts import VERSION
from robofleet.config.load import resolved_yaml
from robofleet.config.tree import Config
from robofleet.recording.channels import ENCODING, SCHEMA_ENCODING, schema
from robofleet.recording.chunks import encode
from robofleet.recording.log import CONFIG, COUNT, DROPPED, ENDING, LIBRARY, PROFILE, PROVENANCE

ENDED = {
    "outcome": "completed", "cause": None, "elapsed_s": 1.0, "trace_hash": None, "tick_durations_ns": None,
    "tracker_durations_ns": None,
}  # fmt: skip
MADE = {
    "mode": "lockstep", "epoch_ns": "0", "wire": str(VERSION), "build": "1", "architecture": "x86_64",
    "processor": "none",
}  # fmt: skip


def record(opcode: int, body: bytes) -> bytes:
    return pack("<BQ", opcode, len(body)) + body


def message(channel: int, data: bytes, length: int | None = None) -> bytes:
    body = pack("<HIQQ", channel, 1, 1, 1) + data
    return pack("<BQ", 5, len(body) if length is None else length) + body


def chunk(content: bytes, compression: str = "zstd", claimed_size: int | None = None) -> bytes:
    packed = zstandard.ZstdCompressor(3).compress(content) if compression == "zstd" else content
    return encode(
        Chunk(compression, packed, 1, 1, zlib.crc32(content), len(content) if claimed_size is None else claimed_size)
    )


def zeros(size: int, claimed_size: int) -> bytes:
    """Return a chunk whose frame holds ``size`` zeros and says so, and whose header says ``said``."""
    compressor = zstandard.ZstdCompressor(3).compressobj(size=size)
    block = bytes(1 << 22)
    packed = b"".join(compressor.compress(block) for _ in range(size // len(block))) + compressor.flush()
    return encode(Chunk("zstd", packed, 1, 1, 0, claimed_size))


def file(
    config: str | bytes | Config,
    *blocks: bytes,
    library: str = LIBRARY.format("0.1.0", VERSION),
    profile: str = PROFILE,
    attached: Sequence[tuple[str, bytes]] = (),
    metadata: Sequence[tuple[str, dict[str, str]]] = (),
) -> bytes:
    """Return a file of one good message, with what a test changes; its index is missing, as after a kill."""
    text = resolved_yaml(config) if isinstance(config, Config) else config
    data = text if isinstance(text, bytes) else text.encode()
    parts = [MAGIC, encode(Header(profile, library)), encode(Attachment(0, 0, CONFIG, "application/yaml", data))]
    parts += [encode(Attachment(0, 0, name, "application/json", content)) for name, content in attached]
    parts += [encode(Metadata(name, content)) for name, content in metadata]
    return b"".join([*parts, *(blocks or (good(),))])


def definitions() -> bytes:
    topic = key("platoon", TICK)
    name, description = schema(topic)
    return encode(Schema(1, description, SCHEMA_ENCODING, name)) + encode(Channel(1, topic, ENCODING, {}, 1))


def good() -> bytes:
    return chunk(definitions() + message(1, b"something"))


def nested(depth: int, pair: str = "[]") -> str:
    return pair[0] * depth + pair[1] * depth


def laughs() -> str:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]" for k in range(1, 12)]
    return "\n".join(lines)


def configurations(config: Config) -> Iterator[tuple[str, str | bytes]]:
    """Yield what may stand in place of a configuration, by name."""
    yield "aliases", laughs()
    yield "lists in lists", nested(200_000)
    yield "mappings in mappings", "{a: " * 100_000
    yield "blocks in blocks", "- " * 100_000
    yield "megabytes", "a: [" + "1, " * 3_000_000 + "1]"
    yield "a number base 60", "a: 1" + ":1" * 400_000
    yield "a long number", "a: " + "1" * 900_000 + "x"
    yield "a tag", "!!python/object/apply:os.system ['true']"
    yield "no UTF-8", b"\xff\xfe\x00a"
    yield "a character", "a: \x00"
    yield "tabs", "a:\n\t- b"
    yield "two documents", "a: 1\n---\nb: 2"
    yield "empty", ""
    yield "a scalar", "text"
    yield "twice", "a: 1\na: 2"
    yield "an escape", "\x1b[2J\na: {b"
    text = resolved_yaml(config)
    yield "a group of nobody", text.replace("  - r4\n  path:", "  - r5\n  path:")
    yield "a group of one twice", text.replace("  - r4\n  path:", "  - r3\n  path:")
    yield "equal ids", text.replace("id: r2", "id: r1")


def chunks() -> Iterator[tuple[str, tuple[bytes, ...]]]:
    """Yield blocks of which at least one is wrong."""
    many = b"".join(encode(Channel(k % 65536, f"rf/{k}", ENCODING, {}, 1)) for k in range(70_000))
    endless = pack("<QQIIQ", 0, 0, 0, 0, 1 << 63)
    yield "gigabytes", (good(), zeros(1 << 30, 1 << 30))
    yield "gigabytes that are said to be few", (good(), zeros(1 << 30, 100))
    yield "few that are said to be gigabytes", (good(), chunk(b"x", claimed_size=3 << 30))
    yield "lz4", (good(), chunk(b"x" * 100, "lz4", 3 << 30))
    yield "not compressed", (good(), chunk(definitions(), ""))
    mega = chunk(message(1, bytes(15 << 20)))
    yield "many large ones", (good(), *[mega] * 200)
    yield "a message beyond its chunk", (chunk(definitions() + message(1, b"x", 1 << 40)),)
    yield "a message without its head", (chunk(definitions() + record(5, b"x")),)
    yield "half a record", (chunk(definitions() + b"\x05\x01"),)
    yield "a schema that is none", (chunk(definitions() + record(3, b"\x01")),)
    yield "a topic that is no text", (chunk(record(4, pack("<HHI", 1, 1, 2) + b"\xff\xff" + bytes(12))),)
    yield (
        "channels out of order",
        (chunk(definitions() + encode(Channel(9, "rf/x", ENCODING, {}, 1)) + message(1, b"x")), b"\x00"),
    )
    yield "many channels", (
        chunk(definitions() + many + message(1, b"x")), b"\x00")  # fmt: skip
    yield "an attachment of no length", (good(), record(9, endless + pack("<I", zlib.crc32(endless))))
    yield "a metadata record of gigabytes", (good(), pack("<BQ", 12, 1 << 40))
    yield "a chunk that is none", (good(), record(6, b"\x00" * 7))
    yield "an end that is none", (good(), encode(DataEnd(7)))


def endings() -> Iterator[tuple[str, bytes]]:
    """Yield what may stand in place of how a run ended."""
    for name in ENDED:
        for wrong in (7, "text", [1], ["text"], {"a": 1}, -1, 1e300, 10**400, True, "x" * 100_000):
            yield f"{name} is {wrong!s:.12}", json.dumps(ENDED | {name: wrong}).encode()
        yield f"{name} is NaN", json.dumps(ENDED | {name: float("nan")}).encode()
        yield f"{name} is nested", (json.dumps(ENDED | {name: "@"}).replace('"@"', nested(100_000))).encode()
    yield "no JSON", b"{"
    yield "nested", nested(100_000).encode()
    yield "no text", b"\xff\xfe"
    yield "a list", b"[]"


def metadata() -> Iterator[tuple[str, tuple[str, dict[str, str]]]]:
    """Yield metadata that say what cannot be."""
    for count in ("9" * 5000, "-1", "text", "1e3", str(10**30), ""):
        yield f"dropped {count:.9}", (DROPPED, {COUNT: count})
        for field in ("epoch_ns", "wire", "build"):
            yield f"{field} {count:.9}", (PROVENANCE, MADE | {field: count})
    yield "nothing", (PROVENANCE, {})
    yield "other names", (PROVENANCE, MADE | {"version of \x1b[2J": "\x1b]0;x\x07", "mode": "\x1b[2J\n\n"})


def makers() -> Iterator[tuple[str, dict[str, str]]]:
    """Yield headers."""
    yield "an escape", {"library": "\x1b[2J\nsecond line"}
    yield "a long name", {"library": "x" * 5_000_000}
    yield "a long number", {"library": LIBRARY.format("0.1.0", "3" * 5000)}
    yield "a long version", {"library": LIBRARY.format("\x1b[2J", VERSION)}
    yield "another profile", {"profile": "x" * 100}


def runs(config: Config) -> Iterator[tuple[str, bytes]]:
    """Yield every kind of file, by name."""
    for name, text in configurations(config):
        yield f"configuration: {name}", file(text)
    for name, blocks in chunks():
        yield f"chunk: {name}", file(config, *blocks)
    for name, ending in endings():
        yield f"ending: {name}", file(config, attached=[(ENDING, ending)])
    for name, content in metadata():
        yield f"metadata: {name}", file(config, metadata=[content])
    for name, made in makers():
        yield f"maker: {name}", file(config, **made)
