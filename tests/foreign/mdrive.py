"""Registers and mnemonics of an MDrive: the tables of the MODBUS/TCP Fieldbus Manual, typed by hand; the functions that
only it has, as PDUs of pymodbus; a terminal on port 503."""

from pymodbus.pdu import ModbusPDU

from conftest import receive

A, C1, C2, CE, D1, D, EE, EF, ER, HC, HT, I1, IL = 0x00, 0x05, 0x07, 0x09, 0x0F, 0x18, 0x1E, 0x1F, 0x21, 0x29, 0x2C, 0x2D, 0x3A
MA, MP, MR, MS, MT, MV, O1, OT, P, R1, RC, S, SL = 0x43, 0x45, 0x46, 0x48, 0x49, 0x4A, 0x4B, 0x56, 0x57, 0x5F, 0x67, 0x76, 0x78
TE, V, VC, VI, VM, AS, AF, V1, V2 = 0x7D, 0x85, 0x88, 0x89, 0x8B, 0x8E, 0x8F, 0xA8, 0xAA

S1, S13, TR, EX, END, PS, RS = b"  1S", b" 31S", b"  RT", b"  XE", b"   E", b"  SP", b"  SR"
"""Mnemonics as functions 65 and 66 take them: reversed and padded (4.3.1)."""


class ReadSpecificResponse(ModbusPDU):
    """The answer to function 65 (4.3.2): the characters."""

    function_code = 65
    rtu_byte_count_pos = 2

    def __init__(self, text="", dev_id=1, transaction_id=0):
        super().__init__(dev_id=dev_id, transaction_id=transaction_id)
        self.text = text

    def encode(self):
        return bytes([len(self.text)]) + self.text.encode()

    def decode(self, data):
        assert data[0] == len(data) - 1
        self.text = data[1:].decode()


class ReadSpecific(ModbusPDU):
    """Function 65: what a mnemonic is set to; of a program, what to do with it."""

    function_code = 65
    rtu_frame_size = 8

    def __init__(self, mnemonic=b"    ", label=None, dev_id=1, transaction_id=0):
        super().__init__(dev_id=dev_id, transaction_id=transaction_id)
        self.mnemonic, self.label = mnemonic, label

    def encode(self):
        return self.mnemonic + (b"" if self.label is None else bytes([len(self.label)]) + self.label)

    def decode(self, data):
        self.mnemonic = data[:4]


class WriteSpecificResponse(ModbusPDU):
    """The answer to function 66 (4.3.3): the mnemonic again."""

    function_code = 66
    rtu_frame_size = 9

    def __init__(self, mnemonic=b"    ", dev_id=1, transaction_id=0):
        super().__init__(dev_id=dev_id, transaction_id=transaction_id)
        self.mnemonic = mnemonic

    def encode(self):
        return b"\4" + self.mnemonic

    def decode(self, data):
        assert data[0] == 4
        self.mnemonic = data[1:]


class WriteSpecific(ModbusPDU):
    """Function 66: sets a mnemonic to the value in a string."""

    function_code = 66
    rtu_byte_count_pos = 6

    def __init__(self, mnemonic=b"    ", text=b"", dev_id=1, transaction_id=0):
        super().__init__(dev_id=dev_id, transaction_id=transaction_id)
        self.mnemonic, self.text = mnemonic, text

    def encode(self):
        return self.mnemonic + bytes([len(self.text)]) + self.text

    def decode(self, data):
        self.mnemonic, self.text = data[:4], data[5:]


class Terminal:
    """A program on port 503 that waits for each prompt."""

    def __init__(self, drivetwin, drive=None):
        self.socket = drivetwin.socket("mcode", drive)

    def receive_until(self, end):
        """All bytes up to an end."""
        got = b""
        while not got.endswith(end):
            got += receive(self.socket, 1)
        return got

    def ask(self, line, prompt=b">"):
        """A line and what is printed: between its echo and the prompt."""
        self.socket.sendall(line.encode() + b"\r")
        got = self.receive_until(prompt)
        echo = line.encode() + b"\r\n"
        assert got.startswith(echo), got
        return got[len(echo) : -1].decode().removesuffix("\r\n")

    def program(self, lines):
        """Lines, none of which prints."""
        for line in lines.split("\n"):
            assert self.ask(line) == ""

    def close(self):
        self.socket.close()


def signed(words):
    """Two registers, the high word first."""
    return int.from_bytes(b"".join(word.to_bytes(2, "big") for word in words), "big", signed=True)


def halves(value):
    """The two registers of a value."""
    return [value >> 16 & 0xFFFF, value & 0xFFFF]
