"""What the router's log says of links that it refused, whoever knocks how often."""

from io import StringIO

from robofleet.processes.log_lines import say_of_links

ANSI = "\x1b[2m2026-11-23T13:15:28.536023Z\x1b[0m \x1b[33m WARN\x1b[0m acc-0 ThreadId(04) \x1b[2m"
NO_CERTIFICATE = (
    f"{ANSI}zenoh_link_tls::unicast\x1b[0m\x1b[2m:\x1b[0m peer sent no certificates. "
    "Hint: increase the system open file limit.\n"
)
UNKNOWN = (
    f"{ANSI}zenoh_link_commons::quic::unicast\x1b[0m\x1b[2m:\x1b[0m QUIC acceptor failed: "
    'reason: "invalid peer certificate: UnknownIssuer" }) at /root/x/unicast.rs:120.\n'
)
OTHER = f"{ANSI}zenoh::net::routing\x1b[0m\x1b[2m:\x1b[0m Transport returned multiple network interfaces\n"


def said_of(lines: list[str], at_s: list[float]) -> list[str]:
    said: list[str] = []
    times = iter(at_s)
    now = [0]

    def now_ns() -> int:
        return now[0]

    class Lines(StringIO):
        def __next__(self) -> str:
            line = super().__next__()
            now[0] = round(next(times) * 1e9)
            return line

    say_of_links(Lines("".join(lines)), said.append, now_ns)
    return said


def test_each_refused_link_is_said_with_its_reason_and_nothing_else_is() -> None:
    said = said_of([NO_CERTIFICATE, OTHER, UNKNOWN], [1, 2, 3])
    assert said == [
        "a link was refused: peer sent no certificates",
        'a link was refused: QUIC acceptor failed: reason: "invalid peer certificate: UnknownIssuer" })',
    ]


def test_a_flood_of_them_costs_twenty_lines_a_minute_and_is_counted() -> None:
    said = said_of([NO_CERTIFICATE] * 1001, [1.0] * 1000 + [62.0])
    assert len(said) == 20 + 1 + 1
    assert said[20] == "980 more links were refused"
