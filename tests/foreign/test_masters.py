"""Masters that we did not write read the drive, configure it and are refused by it."""

import threading

import pytest
from minimalmodbus import IllegalRequestError, Instrument, NoResponseError
from pymodbus.pdu import ExceptionResponse

from conftest import ask, receive
from md3 import DEFAULTS, SERIAL_PORT, USER_REGISTER
from modbus import crc, frame, serial_port, write


def test_pymodbus_over_tcp(run, tcp):
    client = tcp(run("--fast-boot"))
    assert client.read_holding_registers(0, count=32).registers == DEFAULTS
    written = client.write_register(USER_REGISTER, 0x1234)
    assert not written.isError() and written.registers == [0x1234]
    assert client.read_holding_registers(USER_REGISTER).registers == [0x1234]


def test_the_drive_answers_after_its_start_up(run, tcp):
    drivetwin = run("--time", "manual")
    with drivetwin.socket() as early:
        early.sendall(frame(1, 3, 0, 0, 0, 1))
        drivetwin.advance(2.6)
        # If the drive had received the first request, its answer would come before the second one's.
        assert ask(early, frame(1, 3, 0, 0x15, 0, 1), 7) == frame(1, 3, 2, 0x13, 0x88)


def test_pymodbus_on_a_pty_opened_twice(run, serial):
    drivetwin = run("--fast-boot")
    for value in (1, 2):
        client = serial(drivetwin)
        assert client.read_holding_registers(0, count=32).registers == [
            *DEFAULTS[:USER_REGISTER], value - 1, *DEFAULTS[USER_REGISTER + 1 :]
        ]  # fmt: skip
        assert not client.write_register(USER_REGISTER, value).isError()
        client.close()


def test_minimalmodbus_on_a_pty_opened_twice_with_parity(run):
    drivetwin = run("--fast-boot")
    for value in (1, 2):
        with serial_port(drivetwin, parity="E", timeout=3) as port:
            master = Instrument(port, 1)
            assert master.read_registers(0, 32) == [
                *DEFAULTS[:USER_REGISTER], value - 1, *DEFAULTS[USER_REGISTER + 1 :]
            ]  # fmt: skip
            master.write_register(USER_REGISTER, value, functioncode=6)
            assert master.read_register(USER_REGISTER) == value
            assert master.read_long(0x14, signed=True) == 5_000
            # It waits for as many bytes as a good answer has, and then finds the exception.
            with pytest.raises(IllegalRequestError, match="illegal data address"):
                master.read_register(0x20)


@pytest.mark.parametrize(
    ("request_", "code"),
    [
        (lambda c: c.read_coils(0), 1),
        (lambda c: c.read_discrete_inputs(0), 1),
        (lambda c: c.read_input_registers(0), 1),
        (lambda c: c.write_coil(0, True), 1),
        (lambda c: c.write_registers(0x1D, [1]), 1),
        (lambda c: c.read_holding_registers(0, count=33), 2),
        (lambda c: c.read_holding_registers(31, count=2), 2),
        (lambda c: c.read_holding_registers(32), 2),
        (lambda c: c.write_register(0x0B, 1), 2),
        (lambda c: c.write_register(0x1B, 1), 2),
        (lambda c: c.write_register(0x1E, 1), 2),
        (lambda c: c.write_register(0x1F, 1), 2),
        (lambda c: c.write_register(0x00, 0), 2),
        (lambda c: c.write_register(0x00, 248), 2),
        (lambda c: c.write_register(0x20, 1), 2),
    ],
)
def test_exceptions(run, tcp, request_, code):
    """6.1, 6.2: 01 for a function, 02 for an address, and nothing has changed."""
    client = tcp(run("--fast-boot", "--time", "manual"))
    refusal = request_(client)
    assert isinstance(refusal, ExceptionResponse) and refusal.exception_code == code
    assert client.read_holding_registers(0, count=32).registers == DEFAULTS


def test_broadcast_is_obeyed_and_not_answered(run, tcp):
    drivetwin = run("--fast-boot", "--time", "manual")
    with drivetwin.socket() as master:
        master.sendall(write(0, USER_REGISTER, 7))
        # An answer to the broadcast would come before this one.
        assert ask(master, frame(1, 3, 0, USER_REGISTER, 0, 1), 7) == frame(1, 3, 2, 0, 7)
    client = tcp(drivetwin)
    client.write_register(USER_REGISTER, 8, device_id=0, no_response_expected=True)
    assert client.read_holding_registers(USER_REGISTER).registers == [8]


def test_a_change_of_address_holds_from_the_next_frame(run, tcp):
    drivetwin = run("--fast-boot", "--time", "manual")
    client = tcp(drivetwin)
    changed = client.write_register(0, 5, device_id=1)
    assert not changed.isError() and changed.dev_id == 1
    with drivetwin.socket() as master:
        master.sendall(frame(1, 3, 0, 0, 0, 1))
        assert ask(master, frame(5, 3, 0, 0, 0, 1), 7) == frame(5, 3, 2, 0, 5)


@pytest.mark.parametrize(
    ("setting", "line"),
    [
        (0x25, {"baudrate": 115_200, "parity": "E"}),
        (0x11, {"baudrate": 9_600, "parity": "O"}),
        (0x2A, {"baudrate": 19_200, "parity": "E", "stopbits": 2}),
        (0x07, {"baudrate": 460_800, "parity": "N"}),
    ],
)
def test_a_change_of_the_line_holds_from_the_next_frame(run, setting, line):
    """7.22, on the pty, whose speed, stop bits and odd parity a master sets."""
    drivetwin = run("--fast-boot")
    with serial_port(drivetwin, timeout=3) as port:
        Instrument(port, 1).write_register(SERIAL_PORT, setting, functioncode=6)
        with pytest.raises(NoResponseError):
            Instrument(port, 1).read_register(SERIAL_PORT)
    with serial_port(drivetwin, **line) as port:
        assert Instrument(port, 1).read_register(SERIAL_PORT) == setting


def test_several_clients_share_the_line(run):
    """Each gets the answers to its own requests; all receive everything that the drive sends."""
    drivetwin = run("--fast-boot")
    rounds, clients = 10, [drivetwin.socket() for _ in range(4)]
    requests = [frame(1, 3, 0, 0, 0, count) for count in (1, 3, 5, 7)]
    replies = [
        frame(1, 3, 2 * count, *b"".join(word.to_bytes(2, "big") for word in DEFAULTS[:count]))
        for count in (1, 3, 5, 7)
    ]
    heard = [[] for _ in clients]

    def master(place):
        """Repeats its own request, each time until it receives the answer to it."""
        for _ in range(rounds):
            clients[place].sendall(requests[place])
            while True:
                head = receive(clients[place], 3)
                heard[place].append(head + receive(clients[place], head[2] + 2))
                if heard[place][-1] == replies[place]:
                    break

    masters = [threading.Thread(target=master, args=(place,)) for place in range(4)]
    for thread in masters:
        thread.start()
    for thread in masters:
        thread.join()
    for place, client in enumerate(clients):
        while len(heard[place]) < rounds * len(clients):
            head = receive(client, 3)
            heard[place].append(head + receive(client, head[2] + 2))
        client.close()
    assert all(stream == heard[0] for stream in heard)
    assert all(heard[0].count(reply) == rounds for reply in replies)


def test_noise_does_not_spoil_the_next_frame(run):
    drivetwin = run("--fast-boot", "--time", "manual")
    good, reply = frame(1, 3, 0, 0x15, 0, 1), frame(1, 3, 2, 0x13, 0x88)
    with drivetwin.socket() as master:
        for noise in (
            frame(2, 3, 0, 0, 0, 1),
            frame(1, 3, 0, 0, 0, 1)[:-1] + b"\x00",
            bytes([1, 6, 0, 0x1D, 0, 9]) + bytes(2),
            bytes(range(255)),
            b"\xff" * 600,
        ):
            assert crc(noise[:-2]) != noise[-2:] or noise[0] != 1
            master.sendall(noise)
            drivetwin.advance(1)
            assert ask(master, good, len(reply)) == reply
