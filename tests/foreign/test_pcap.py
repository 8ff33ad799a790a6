"""Captures, read by Wireshark's `tshark` with its defaults, unless a test sets something."""

import subprocess
from pathlib import Path

from conftest import PATIENCE, ask
from md3 import USER_REGISTER
from modbus import frame, write
from rs434 import SPEED

CAPTURES = Path(__file__).parents[1] / "captures"

MOVE_STEPS = 0x12
"""Two registers, high word first: 0x0000 and 0x2710 in a new one (7.16)."""
RTU_PORT = ("-o", "mbrtu.tcp.port:502")
"""The one setting that helps: a request of function 6 and its reply are the same bytes."""
COLUMNS = ("-T", "tabs", "-o", 'gui.column.format:"Protocol","%p","Info","%i"')


def tshark(file, *options):
    """What it prints of each packet, split at tabs."""
    command = ["tshark", "-n", "-r", file, *options]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE)
    assert done.returncode == 0, done.stderr
    return [line.split("\t") for line in done.stdout.splitlines()]


def shown(file, *options):
    """The columns of protocol and information, without the blanks that align them."""
    return [[column.strip() for column in packet] for packet in tshark(file, *COLUMNS, *options)]


def fields(file, *names, options=()):
    """Fields of each packet; one that is not there is empty."""
    return tshark(file, *options, "-T", "fields", *(word for name in names for word in ("-e", name)))


def captured(run, tmp_path, talk, *options, kind="md3"):
    """The file that a drive leaves after a talk on its line, with the clock standing."""
    file = tmp_path / "line.pcapng"
    drivetwin = run("--fast-boot", "--time", "manual", "--pcap", file, *options, kind=kind)
    with drivetwin.socket() as sock:
        talk(drivetwin, sock)
    assert drivetwin.stop() == 0
    return file


def test_requests_and_replies_are_modbus_rtu(run, tmp_path):
    def talk(_, sock):
        ask(sock, frame(1, 3, *SPEED.to_bytes(2), 0, 2), 9)
        ask(sock, frame(1, 16, *SPEED.to_bytes(2), 0, 2, 4, 0x04, 0xD2, 0x00, 0x64), 8)
        ask(sock, frame(1, 3, 0, 0, 0, 1), 5)

    file = captured(run, tmp_path, talk, "--set", "TYPE_MODBUS=3", "--set", "SPEED=777", kind="rs434544")
    assert shown(file) == [
        ["Modbus RTU", "Query: Unit:   1, Func:   3: Read Holding Registers"],
        ["Modbus RTU", "Response: Unit:   1, Func:   3: Read Holding Registers"],
        ["Modbus RTU", "Query: Unit:   1, Func:  16: Write Multiple Registers"],
        ["Modbus RTU", "Response: Unit:   1, Func:  16: Write Multiple Registers"],
        ["Modbus RTU", "Query: Unit:   1, Func:   3: Read Holding Registers"],
        ["Modbus RTU", "Response: Unit:   1, Func:   3: Read Holding Registers. Exception returned"],
    ]
    of_modbus = ["func_code", "regnum16", "regval_uint16", "word_cnt", "exception_code", "request_frame"]
    rows = f"{SPEED},{SPEED + 1}"
    packets = fields(file, *(f"modbus.{name}" for name in of_modbus))
    assert packets[1][2].split(",")[0] == "777"
    packets[1][2] = ""
    assert packets == [
        ["3", "", "", "2", "", ""],
        ["3", rows, "", "", "", "1"],
        ["16", rows, "1234,100", "2", "", ""],
        ["16", "", "", "2", "", "3"],
        ["3", "", "", "1", "", ""],
        ["3", "", "", "", "2", ""],
    ]
    assert fields(file, "frame.interface_name", "mbrtu.unit_id") == [["rs485", "1"]] * 6
    assert fields(file, "frame.comment") == [
        ["read SPEED, ACC -> SPEED = 777, ACC = 100"],
        ["SPEED = 777, ACC = 100"],
        ["write SPEED = 1234, ACC = 100 -> done"],
        ["done"],
        ["read 0x0000 -> refused: there is no register at 0x0000 (02)"],
        ["refused: there is no register at 0x0000 (02)"],
    ]
    assert fields(file, "frame.packet_flags_direction") == [["0x00000001"], ["0x00000002"]] * 3


def test_stamps_are_the_time_of_the_bench(run, tmp_path):
    began = []

    def talk(drivetwin, sock):
        drivetwin.advance(1.25)
        began.append(drivetwin.seconds())
        ask(sock, frame(1, 3, 0, MOVE_STEPS, 0, 2), 9)

    file = captured(run, tmp_path, talk)
    ((asked,), (answered,)) = fields(file, "frame.time_epoch")
    assert abs(float(asked) - began[0]) < 1e-6
    # 8 characters of 11 bits at 9600 baud, then 3.5 of silence.
    assert 0 <= float(answered) - float(asked) - 11.5 * 11 / 9600 < 0.01


def test_single_writes_are_told_apart_by_their_way_or_by_the_port(run, tmp_path):
    request = write(1, USER_REGISTER, 0xCAFE)
    file = captured(run, tmp_path, lambda _, sock: ask(sock, request, len(request)))
    names = ["frame.packet_flags_direction", "modbus.func_code"]
    assert fields(file, *names) == [["0x00000001", "6"], ["0x00000002", "6"]]
    kinds = [info.split(":")[0] for _, info in shown(file, *RTU_PORT)]
    assert kinds == ["Query", "Response"]
    values = fields(file, "modbus.reference_num", "modbus.data", options=RTU_PORT)
    assert values == [["29", "cafe"]] * 2


def test_a_frame_with_a_wrong_crc_is_data(run, tmp_path):
    good = frame(1, 3, 0, MOVE_STEPS, 0, 2)

    def talk(drivetwin, sock):
        sock.sendall(good[:-1] + bytes([good[-1] ^ 1]))
        drivetwin.advance(0.1)
        ask(sock, good, 9)

    file = captured(run, tmp_path, talk)
    protocols = fields(file, "frame.protocols", "frame.packet_flags_crc_error")
    assert protocols == [["exported_pdu:data", "1"], *[["exported_pdu:mbrtu:modbus", "0"]] * 2]
    assert [protocol for protocol, _ in shown(file)] == ["Modbus RTU"] * 3


def texts(file):
    """The flags of each packet of text, and its characters."""
    names = ["frame.protocols", "frame.packet_flags", "exported_pdu.exported_pdu"]
    packets = fields(file, *names)
    assert {protocols for protocols, _, _ in packets} == {"exported_pdu:data-text-lines"}
    return [(flags, bytes.fromhex(text)) for _, flags, text in packets]


def test_text_is_lines(run, tmp_path):
    banner = b"QSB-D  0E!\r\n"

    def talk(drivetwin, sock):
        # It was sent before there was a reader.
        drivetwin.advance(0.1)
        ask(sock, b"R0E\r\n", len(b"r 0E 00000000 !\r\n"))

    file = captured(run, tmp_path, talk, kind="qsb-d")
    assert texts(file) == [
        ("0x00000002", banner),
        ("0x00000001", b"R0E\r\n"),
        ("0x00000002", b"r 0E 00000000 !\r\n"),
    ]
    assert shown(file) == [["Text", ""]] * 3
    assert fields(file, "frame.comment") == [[""], ["read ReadEncoder -> ReadEncoder = 0"], [""]]


def test_messages_in_ascii_are_lines(run, tmp_path):
    # HW_MAJOR of a 434544 is 1001 (6.8).
    request, reply = b":01048001000179\r\n", b":01040203E90D\r\n"
    broken = b":01048001000178\r\n"

    def talk(drivetwin, sock):
        sock.sendall(broken)
        drivetwin.advance(0.1)
        assert ask(sock, request, len(reply)) == reply

    file = captured(run, tmp_path, talk, "--set", "TYPE_MODBUS=1", kind="rs434544")
    assert texts(file) == [("0x01000001", broken), ("0x00000001", request), ("0x00000002", reply)]
    assert shown(file) == [["Modbus ASCII", ""]] * 3


def test_a_hand_made_file_of_modbus_tcp(run):
    """The file is made by hand; a test of the writer checks that it writes the same bytes."""
    file = CAPTURES / "modbus-tcp.pcapng"
    assert shown(file) == [
        ["Modbus/TCP", "Query: Trans:     1; Unit:   1, Func:   3: Read Holding Registers"],
        ["Modbus/TCP", "Response: Trans:     1; Unit:   1, Func:   3: Read Holding Registers"],
    ]
    names = ["frame.interface_name", "frame.time_epoch", "modbus.regnum16", "modbus.regval_uint16"]
    assert fields(file, *names) == [
        ["m.modbus", "1.000000062", "", ""],
        ["m.modbus", "300.000000000", "34,35", "4660,2"],
    ]
