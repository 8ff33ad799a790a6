"""An MDrive over its two TCP ports: pymodbus on 502 with all of the drive's functions, a program of lines on 503, raw
sockets for what no master sends."""

import socket

import pytest
from pymodbus.client import ModbusTcpClient
from pymodbus.pdu import ExceptionResponse

from conftest import PATIENCE, ask, receive
from mdrive import *

COUNTER = """PG 200
LB A3
VA V1
VA V2=5
V1=V2*1000
LB A4
IC V1
H 100
BR A4,V1<5010
E
PG"""
"""A program that counts to 5,010, ten times a second."""


@pytest.fixture
def drive(run):
    """A drive whose clock stops between two requests."""

    def start(*options, kind="mdrive"):
        drivetwin = run("--time", "manual", "--fast-boot", *options, kind=kind)
        drivetwin.advance(1)
        return drivetwin

    return start


@pytest.fixture
def opened():
    """What the test leaves open is closed with it."""
    things = []
    yield things
    for thing in things:
        thing.close()


class Master:
    """pymodbus that requires good answers, with functions 65 and 66."""

    def __init__(self, drivetwin, opened):
        host, port = drivetwin.ports["modbus"]
        self.client = ModbusTcpClient(host, port=port, timeout=PATIENCE, retries=0)
        assert self.client.connect()
        self.client.register(ReadSpecificResponse)
        self.client.register(WriteSpecificResponse)
        opened.append(self.client)

    def words(self, address, count):
        answer = self.client.read_holding_registers(address, count=count)
        assert not answer.isError(), answer
        assert len(answer.registers) == count
        return answer.registers

    def word(self, address):
        (word,) = self.words(address, 1)
        return word

    def long(self, address):
        return signed(self.words(address, 2))

    def write(self, address, *words):
        answer = self.client.write_registers(address, list(words))
        assert not answer.isError(), answer
        assert (answer.address, answer.count) == (address, len(words))

    def write_long(self, address, value):
        self.write(address, *halves(value))

    def read_specific(self, mnemonic, label=None):
        answer = self.client.execute(False, ReadSpecific(mnemonic, label))
        assert not answer.isError(), answer
        return answer.text

    def write_specific(self, mnemonic, text=b""):
        answer = self.client.execute(False, WriteSpecific(mnemonic, text))
        assert not answer.isError(), answer
        assert answer.mnemonic == mnemonic


@pytest.fixture
def master(drive, opened):
    """A drive, and pymodbus on its port 502."""

    def start(*options, kind="mdrive"):
        drivetwin = drive(*options, kind=kind)
        return drivetwin, Master(drivetwin, opened)

    return start


def refused(answer, code):
    """An exception with that code."""
    assert isinstance(answer, ExceptionResponse), answer
    assert answer.exception_code == code, answer


def header(transaction, unit, *pdu):
    """A whole message: the header of 3.2.1 and a PDU."""
    return bytes([*transaction.to_bytes(2, "big"), 0, 0, *(len(pdu) + 1).to_bytes(2, "big"), unit, *pdu])


ASK, ANSWER = (3, 0, HC, 0, 1), (3, 2, 0, 5)
"""A question that every new drive answers so: HC is 5 %."""


def test_registers_are_read_and_written(master):
    _, master = master()
    assert master.long(VM) == 768_000
    assert master.words(VI, 4) == [0, 1_000, 0x000B, 0xB800]
    master.write_long(VM, 600_000)
    master.write(VI, *halves(1_000_000), *halves(2_000_000))
    assert (master.long(VI), master.long(VM)) == (1_000_000, 2_000_000)
    master.write(RC, 75)
    assert master.word(RC) == 75


def test_bits_are_read_and_written(master):
    _, master = master()
    assert master.client.read_discrete_inputs(I1, count=4).bits[:4] == [False] * 4
    for number in range(1, 5):
        mnemonic = f"  {number}S".encode()
        master.write_specific(mnemonic, b"=16,1,0")
        assert master.read_specific(mnemonic) == "16, 1, 0"
    assert not master.client.write_coil(O1 + 2, True).isError()
    assert not master.client.write_coil(O1, True).isError()
    assert master.client.read_coils(O1, count=4).bits[:4] == [True, False, True, False]
    assert not master.client.write_coil(O1, False).isError()
    assert master.words(O1, 4) == [0, 0, 1, 0]


def test_what_is_refused(master):
    _, master = master()
    client = master.client
    refused(client.read_holding_registers(0x0002, count=1), 2)
    refused(client.read_holding_registers(0x00B8, count=1), 2)
    refused(client.read_holding_registers(V1, count=2), 2)
    refused(client.read_holding_registers(R1, count=5), 3)
    refused(client.write_registers(I1, [1]), 2)
    refused(client.write_registers(RC, [101]), 3)
    assert (master.word(EF), master.word(ER), master.word(EF)) == (1, 21, 0)
    refused(client.write_coil(O1, True), 4)
    assert master.word(ER) == 9
    refused(client.write_register(RC, 5), 1)
    refused(client.read_input_registers(0, count=1), 1)
    refused(client.write_coils(O1, [True, True]), 1)
    refused(client.execute(False, ReadSpecific(b"  ZZ")), 2)
    refused(client.execute(False, WriteSpecific(S1, b"nothing")), 3)


@pytest.mark.parametrize("kind, version", [("mdrive", b"MDI 3."), ("mdrive-hybrid", b"ASI 4.")])
def test_identification(master, kind, version):
    _, master = master(kind=kind)
    for code in (2, 3):
        answer = master.client.read_device_information(read_code=code)
        assert not answer.isError(), answer
        information = answer.information
        assert sorted(information) == list(range(7))
        assert information[0] == b"SEM USA" and information[2] == b"4.0.0.0"
        assert information[3] == b"www.imshome.com" and information[4] == b"MDrive Ethernet"
        assert information[6].startswith(version)
    basic = master.client.read_device_information(read_code=1)
    assert sorted(basic.information) == [0, 1, 2]
    one = master.client.read_device_information(read_code=4, object_id=5)
    assert one.information == {5: information[5]}
    assert len(information[5]) == 9
    refused(master.client.read_device_information(read_code=4, object_id=9), 2)


def test_a_move(master):
    """3,840,000 steps in 5.767 s (MCode manual, 7.3.5), 2.5 ms after the command."""
    drivetwin, master = master()
    master.write_long(MR, 3_840_000)
    assert (master.word(MV), master.word(MP)) == (1, 1)
    drivetwin.advance(3)
    assert (master.long(V), master.word(VC)) == (768_000, 0)
    drivetwin.advance(2.75)
    assert master.word(MV) == 1
    drivetwin.advance(0.03)
    assert (master.word(MV), master.long(P), master.long(C1)) == (0, 3_840_000, 3_840_000)


def test_a_program_through_both_ports(master, opened):
    drivetwin, master = master()
    terminal = Terminal(drivetwin)
    opened.append(terminal)
    terminal.program(COUNTER)
    refused(master.client.read_holding_registers(V1, count=2), 2)
    master.write_specific(EX, b"A3")
    drivetwin.advance(0.6)
    assert 5_003 <= master.long(V1) <= 5_007
    master.write_long(V2, 77)
    assert terminal.ask("PR V2") == "77"
    drivetwin.advance(2)
    assert (master.long(V1), terminal.ask("PR BY")) == (5_010, "0")
    assert master.read_specific(EX, b"A3") == ""
    drivetwin.advance(0.3)
    assert master.read_specific(END) == ""
    frozen = master.long(V1)
    assert 5_001 <= frozen <= 5_005
    drivetwin.advance(1)
    assert (master.long(V1), terminal.ask("PR BY")) == (frozen, "0")
    assert "A3 = 200" in terminal.ask("PR UV")


def test_two_terminals(drive, opened):
    drivetwin = drive()
    terminal, other = Terminal(drivetwin), Terminal(drivetwin)
    opened += [terminal, other]
    assert terminal.ask("PR VM") == "768000"
    assert terminal.ask("MR 20000") == ""
    assert terminal.ask("PR MV") == "1"
    drivetwin.advance(1)
    assert terminal.ask("PR P") == "20000"
    assert other.ask("PR P") == "20000"
    terminal.ask("RC=101", prompt=b"?")
    other.ask("R1=5", prompt=b"?")
    assert "21" in other.ask("PR ER")
    assert terminal.ask("R1=6") == ""
    # A segment ends anywhere, and may have several lines.
    for piece in (b"R1=7\rIC R1\rPR ", b"R", b"1\r"):
        terminal.socket.sendall(piece)
        drivetwin.notice()
    expected = b"R1=7\r\n>IC R1\r\n>PR R1\r\n8\r\n>"
    assert receive(terminal.socket, len(expected)) == expected
    assert other.ask("PR R1") == "8"


def test_transactions_are_pipelined_and_cut_anywhere(drive, opened):
    drivetwin = drive()
    raw = drivetwin.socket("modbus")
    opened.append(raw)
    requests = [header(n, n % 256, *ASK) for n in range(300)]
    replies = b"".join(header(n, n % 256, *ANSWER) for n in range(300))
    assert ask(raw, b"".join(requests), len(replies)) == replies
    for byte in b"".join(requests[:3]):
        raw.sendall(bytes([byte]))
        drivetwin.notice()
    assert receive(raw, 33) == replies[:33]


@pytest.mark.parametrize(
    "bad",
    [
        b"GET / HTTP/1.1\r\nHost: x\r\n\r\n",
        b"\0\1\0\1\0\6\1\3\0\x29\0\1",
        b"\0\1\0\0\0\0\1",
        b"\0\1\0\0\0\1\1",
        b"\0\1\0\0\xff\xff" + b"\1" * 300,
        bytes(range(256)),
    ],
)
def test_what_is_no_modbus_ends_its_connection_and_no_other(master, opened, bad):
    drivetwin, master = master()
    raw = drivetwin.socket("modbus")
    opened.append(raw)
    raw.sendall(bad)
    try:
        assert raw.recv(1) == b"", "an answer to what is no request"
    except ConnectionResetError:
        pass
    assert master.word(HC) == 5


def test_half_a_request_disturbs_nobody(master, opened):
    drivetwin, master = master()
    slow = drivetwin.socket("modbus")
    opened.append(slow)
    whole = header(1, 1, *ASK)
    slow.sendall(whole[:7])
    assert master.word(HC) == 5
    drivetwin.advance(3_600)
    assert master.word(HC) == 5
    assert ask(slow, whole[7:], 11) == header(1, 1, *ANSWER)
    # A request that is cut by the end of its connection, closed or reset, is dropped.
    for reset in (False, True):
        gone = drivetwin.socket("modbus")
        gone.sendall(whole[:5])
        drivetwin.notice()
        if reset:
            gone.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
        gone.close()
        drivetwin.notice()
    assert master.word(HC) == 5


def test_half_a_connection_is_served_and_then_closed(drive, opened):
    """A client that has closed its sending side still gets its answers."""
    raw = drive().socket("modbus")
    opened.append(raw)
    raw.sendall(header(1, 1, *ASK))
    raw.shutdown(socket.SHUT_WR)
    assert receive(raw, 11) == header(1, 1, *ANSWER)
    assert raw.recv(1) == b""


def test_who_does_not_read_disturbs_nobody(master, opened):
    """Unread answers are bounded: the drive reads no more from that client, or ends the connection."""
    drivetwin, master = master()
    deaf = drivetwin.socket("modbus")
    opened.append(deaf)
    deaf.setblocking(False)
    requests = header(1, 1, 0x2B, 0x0E, 2, 0) * 1_000
    sent, stuck, most = 0, 0, 100_000_000
    while sent < most and stuck < 20:
        try:
            sent += deaf.send(requests)
            stuck = 0
        except BlockingIOError:
            stuck += 1
            drivetwin.notice()
        except (BrokenPipeError, ConnectionResetError):
            break
    assert sent < most, "it takes everything"
    assert master.word(HC) == 5


def test_more_connections_than_there_is_room_for(drive, opened):
    drivetwin = drive()
    opened += [drivetwin.socket("modbus") for _ in range(80)]
    served = []
    for number, raw in enumerate(opened):
        try:
            raw.sendall(header(number, 1, *ASK))
            answer = raw.recv(11)
        except (BrokenPipeError, ConnectionResetError):
            answer = b""
        assert answer in (b"", header(number, 1, *ANSWER))
        if answer:
            served.append(raw)
    assert len(served) == 64
    # Room again as soon as one has gone.
    served[5].close()
    drivetwin.notice()
    raw = drivetwin.socket("modbus")
    opened.append(raw)
    assert ask(raw, header(9, 9, *ASK), 11) == header(9, 9, *ANSWER)


def test_connections_are_accepted_once_it_has_booted(run, opened):
    """300 ms after power-on; an earlier client is served then, and gets no sign-on."""
    drivetwin = run("--time", "manual", kind="mdrive")
    for _ in range(2):
        modbus, mcode = (drivetwin.socket(port) for port in ("modbus", "mcode"))
        opened += [modbus, mcode]
        modbus.sendall(header(1, 1, *ASK))
        mcode.sendall(b"PR HC\r")
        drivetwin.advance(0.299)
        for early in (modbus, mcode):
            early.setblocking(False)
            with pytest.raises(BlockingIOError):
                early.recv(1)
            early.settimeout(PATIENCE)
        drivetwin.advance(0.001)
        assert receive(modbus, 11) == header(1, 1, *ANSWER)
        assert receive(mcode, 11) == b"PR HC\r\n5\r\n>"
        drivetwin.call("POST", "/api/drives/mdrive/power", {"action": "cycle"})
        assert mcode.recv(1) == b""


def test_a_typed_line_takes_its_time(drive, opened):
    """MC 7.1: 1 to 5 ms, and nothing that is typed in that time is lost."""
    drivetwin = drive()
    terminals = [Terminal(drivetwin) for _ in range(2)]
    opened += terminals
    start = drivetwin.seconds()
    for line, ms in (("PR HC", 2), ("R1=0", 2), ('PR P,"_"V,"_"MV,"_"VC', 5), ("", 1), ("L", 5)):
        terminals[0].ask(line)
        assert round((drivetwin.seconds() - start) * 1_000, 3) == ms, line
        start = drivetwin.seconds()
    for terminal in terminals:
        terminal.socket.sendall(b"IC R1\r\n" * 1_000)
    for terminal in terminals:
        assert receive(terminal.socket, 8_000) == b"IC R1\r\n>" * 1_000
    assert terminals[0].ask("PR R1") == "2000"


def test_who_types_faster_than_the_drive_executes_is_read_no_further(run, opened):
    drivetwin = run("--fast-boot", kind="mdrive")
    flood = drivetwin.socket("mcode")
    opened.append(flood)
    flood.setblocking(False)
    lines = b"IC R1\r" * 10_000
    sent, stuck, most = 0, 0, 100_000_000
    while sent < most and stuck < 20:
        try:
            sent += flood.send(lines)
            stuck = 0
        except BlockingIOError:
            stuck += 1
            drivetwin.notice()
    assert sent < most, "it takes everything"
    # The others take turns with it, and the bus does not wait at all.
    terminal = Terminal(drivetwin)
    opened.append(terminal)
    assert terminal.ask("PR HC") == "5"
    assert Master(drivetwin, opened).word(HC) == 5


def test_any_bytes_on_port_503(drive, opened):
    """Errors, and nothing else; also a line without an end."""
    drivetwin = drive()
    raw = drivetwin.socket("mcode")
    noise = bytes(byte for byte in range(256) if byte not in (3, 5, 10, 13, 27))
    raw.sendall(noise * 200)
    drivetwin.notice()
    raw.close()
    drivetwin.notice()
    terminal = Terminal(drivetwin)
    opened.append(terminal)
    terminal.ask("ER=0")
    assert terminal.ask("PR VM") == "768000"
    assert terminal.ask("PR ER") == "0"


def test_connections_end_with_the_power_and_not_with_a_restart(drive, opened):
    drivetwin = drive()
    terminal, raw = Terminal(drivetwin), drivetwin.socket("modbus")
    opened += [terminal, raw]
    terminal.ask("RC=99")
    terminal.socket.sendall(b"\x03")
    drivetwin.advance(1)
    banner = b""
    while not banner.endswith(b">"):
        banner += receive(terminal.socket, 1)
    assert b"Copyright 2001-2010 by Schneider Electric Motion USA.\r\n" in banner
    assert terminal.ask("PR RC") == "25"
    assert ask(raw, header(1, 1, 3, 0, RC, 0, 1), 11) == header(1, 1, 3, 2, 0, 25)
    drivetwin.call("POST", "/api/drives/mdrive/power", {"action": "off"})
    assert raw.recv(1) == b""
    assert terminal.socket.recv(1) == b""


def test_the_hybrid_calibrates_before_it_moves(master):
    drivetwin, master = master(kind="mdrive-hybrid")
    assert master.word(AS) == 2
    assert master.word(AF) & 128
    master.write(0xA1, 1)
    refused(master.client.write_registers(MR, halves(1_000)), 4)
    assert master.word(ER) == 88
    drivetwin.advance(4)
    assert master.word(AF) & 128
    master.write_long(MR, 1_000)
    drivetwin.advance(1)
    assert master.long(P) == 1_000
