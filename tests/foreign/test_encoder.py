"""An encoder that the control API turns."""

IO_PORT_DATA = 0x0A
A, B = 1 << 5, 1 << 4
"""Bits of IOPortData: J2 pins 10 and 12 (7.9)."""
ENCODER_COUNT = 0x10


def test_an_encoder_turns_there_and_back(run, tcp):
    drivetwin = run("--fast-boot", "--time", "manual")
    client = tcp(drivetwin)

    def pins():
        (port,) = client.read_holding_registers(IO_PORT_DATA).registers
        return port & (A | B)

    def count():
        (count,) = client.read_holding_registers(ENCODER_COUNT).registers
        return count

    def turn(counts):
        drivetwin.call("POST", "/api/drives/md3/encoder", {"counts": counts, "hz": 10_000})
        drivetwin.advance(abs(counts) / 10_000)

    assert (pins(), count()) == (0, 0)
    # A leads B: a cycle is A, A and B, B, none. Each of its four edges counts (7.11).
    made = 0
    for counts, level in [(400, 0), (1, A), (401, A | B), (-1, A), (-402, B), (1, 0)]:
        turn(counts)
        made += counts
        assert (pins(), count()) == (level, made), counts
