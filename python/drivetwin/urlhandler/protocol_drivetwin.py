"""The pyserial URL `drivetwin://`: a serial port with a drive at the other end, in this process.

    drivetwin://md3                                   a drive of this kind
    drivetwin://md3?address=2&Speed=8000&fast_boot=1  with options of `Bench.add`, and registers
    drivetwin://?bench=bench.toml&drive=x             a drive of a bench file
    drive.url()                                       a drive of a bench of this process

Further options: `port`, one of the drive's serial ports; `seed` and `line` of the bench; `time`.

`time=manual`, the default: the clock of the bench stands. A complete request moves it to the end of the reply, and a
read that waits moves it to the next byte, or by its timeout. So nothing waits in real time. `time=real`: the bench
follows the wall clock, `time=x10` ten times faster.

Baud rate, data bits, parity and stop bits must be those of the drive's line, or the drive does not answer. DTR resets a
QSB, as an open does. The attributes `drive` and `bench` of the port are the drive and its bench.
"""

import os
import re
import time
import urllib.parse

from serial import PortNotOpenError, SerialBase, SerialException

import drivetwin
from drivetwin import urlhandler

_BENCH = ("seed", "line")
_DRIVE = ("address", "nv", "program")
_FLAGS = {"1": True, "true": True, "yes": True, "0": False, "false": False, "no": False}
_FOREVER = 1e6
"""Seconds of one of the waits of a read without a timeout."""
_NAP = 0.001
"""Seconds of real time between two looks for bytes."""

_FILES: "dict[tuple[str, str], drivetwin.Bench]" = {}
"""Benches of bench files, by path and time: the drives of two ports may be on one bench."""


class Serial(SerialBase):
    """A serial port with a drive at the other end."""

    BAUDRATES = (
        *(50, 75, 110, 134, 150, 200, 300, 600, 1200, 1800, 2400, 4800, 9600, 19200, 38400, 57600, 115200, 230400),
        *(460800, 500000, 576000, 921600, 1000000, 1152000, 1500000, 2000000, 2500000, 3000000, 3500000, 4000000),
    )

    def __init__(self, *args, **kwargs):
        self.bench = None
        self.drive = None
        self._made_from = None
        self._stream = None
        self._received = bytearray()
        self._cancelled = False
        super().__init__(*args, **kwargs)

    def open(self):
        """Opens the port. The first time it makes the drive, which then lives as long as this object."""
        if self._port is None:
            raise SerialException("Port must be configured before it can be used.")
        if self.is_open:
            raise SerialException("Port is already open.")
        if self._made_from != self.port:
            self._make(self.port)
            self._made_from = self.port
        self._catch_up()
        try:
            self._stream = self.drive.port(self._name)
        except drivetwin.Error as error:
            raise SerialException(str(error)) from error
        self._received.clear()
        self.is_open = True
        try:
            self._reconfigure_port()
        except BaseException:
            self.close()
            raise
        self._update_dtr_state()

    def close(self):
        """Closes the port. The drive goes on."""
        if self.is_open:
            self.is_open = False
            if self._dtr_state and not self.bench.closed:
                self._stream.dtr(False)
            if not self.bench.closed:
                self._stream.close()
            self._stream = None

    def _make(self, url):
        parts = urllib.parse.urlsplit(url)
        options = dict(urllib.parse.parse_qsl(parts.query, keep_blank_values=True))
        kind, port = parts.netloc, options.pop("port", None)
        self._factor, key = _factor(options.pop("time", "manual"))
        if "shared" in options:
            number, name = options.pop("shared"), options.pop("drive", "")
            self.bench = urlhandler.SHARED.get(int(number) if number.isdecimal() else 0)
            if self.bench is None:
                raise drivetwin.Error(f"{url} is of a bench that is not in this process, or is closed")
            self.drive = self.bench[name]
        elif "bench" in options:
            key = (os.path.abspath(options.pop("bench")), key)
            if key not in _FILES or _FILES[key].closed:
                _FILES[key] = drivetwin.Bench.load(key[0])
            self.bench = _FILES[key]
            names = list(self.bench)
            self.drive = self.bench[options.pop("drive", names[0])]
        else:
            of_bench = {name: options.pop(name) for name in _BENCH if name in options}
            if "seed" in of_bench:
                of_bench["seed"] = _seed(of_bench["seed"])
            self.bench = drivetwin.Bench(**of_bench)
            more = {name: options.pop(name) for name in _DRIVE if name in options}
            flag = options.pop("fast_boot", "0")
            if flag not in _FLAGS:
                raise drivetwin.Error(f"fast_boot takes 1 or 0, not '{flag}'")
            self.drive = self.bench.add(kind, fast_boot=_FLAGS[flag], set=options, **more)
            kind, options = "", {}
        if kind or options:
            raise drivetwin.Error(f"{url} has {kind or next(iter(options))!r}, which is for a single drive only")
        self._name = self.drive.ports[0] if port is None else port
        self._began = time.monotonic() - (self.bench.now / self._factor if self._factor else 0.0)

    def _reconfigure_port(self):
        stop = {1: 1, 1.5: None, 2: 2}[self._stopbits]
        if self._parity not in "NEO" or stop is None:
            raise ValueError("a drive's line has no mark or space parity, and 1 or 2 stop bits")
        if not 50 <= self._baudrate <= 4_000_000:
            raise ValueError(f"a drive's line has 50 to 4000000 baud, not {self._baudrate}")
        self._stream.configure(self._baudrate, self._bytesize, self._parity, stop)

    def _catch_up(self):
        """Moves the bench to the time of the wall clock."""
        if self._factor:
            self.bench.run_until(max(self.bench.now, (time.monotonic() - self._began) * self._factor))

    def _take(self):
        """Takes what has come."""
        if not self.is_open:
            raise PortNotOpenError()
        self._catch_up()
        self._received += self._stream.read()

    @property
    def in_waiting(self):
        """Number of bytes that have come and are not read."""
        self._take()
        return len(self._received)

    def read(self, size=1):
        """Reads `size` bytes, or fewer if the timeout ends; without a timeout it waits for all."""
        self._cancelled = False
        self._take()
        timeout = _FOREVER if self._timeout is None else self._timeout
        until = self._clock() + timeout
        while len(self._received) < size and not self._cancelled:
            left = until - self._clock()
            if left <= 0:
                if self._timeout is not None:
                    break
                until = self._clock() + _FOREVER
                continue
            if self._factor:
                time.sleep(min(left, _NAP))
            else:
                self._stream.wait(left)
            self._take()
        taken = bytes(self._received[:size])
        del self._received[:size]
        return taken

    def _clock(self):
        """Seconds that timeouts count: those of the wall clock, or of a bench whose clock stands."""
        return time.monotonic() if self._factor else self.bench.now

    def write(self, data):
        """Sends bytes. If the clock of the bench stands, complete requests are answered when it returns."""
        data = bytes(data)
        self._take()
        try:
            self._stream.write(data)
        except drivetwin.Error as error:
            raise SerialException(str(error)) from error
        if not self._factor:
            self._stream.settle()
        return len(data)

    def flush(self):
        """Waits until all bytes are on the line."""
        self._take()
        if not self._factor:
            self._stream.drain(_FOREVER)
        while self._stream.unsent:
            time.sleep(_NAP)
            self._take()

    @property
    def out_waiting(self):
        """Number of bytes that are not on the line yet."""
        self._take()
        return self._stream.unsent

    def reset_input_buffer(self):
        """Drops what has come."""
        self._take()
        self._received.clear()

    def reset_output_buffer(self):
        """Drops what is not on the line yet."""
        self._take()
        self._stream.drop_unsent()

    def cancel_read(self):
        """Ends a read in another thread, in real time."""
        self._cancelled = True

    def _update_dtr_state(self):
        if self.is_open:
            self._catch_up()
            self._stream.dtr(bool(self._dtr_state))

    def _update_rts_state(self):
        """RTS has no effect."""

    def _update_break_state(self):
        """The drives do not see a break."""

    @property
    def cts(self):
        """Always on."""
        return self._on()

    @property
    def dsr(self):
        """Always on."""
        return self._on()

    @property
    def cd(self):
        """Always on."""
        return self._on()

    @property
    def ri(self):
        """Always off."""
        return not self._on()

    def _on(self):
        if not self.is_open:
            raise PortNotOpenError()
        return True


def _seed(text):
    if not (text.isascii() and text.isdecimal()):
        raise drivetwin.Error(f"seed takes a whole number from 0, not '{text}'")
    return int(text)


def _factor(text):
    """How many times faster than the wall clock the bench is; None: its clock stands."""
    if text == "manual":
        return None, text
    match = re.fullmatch("x([1-9][0-9]{0,3})", text)
    if text != "real" and not (match and int(match[1]) <= 1000):
        raise drivetwin.Error(f"time takes real, xN (N from 1 to 1000) or manual, not '{text}'")
    return (1.0 if match is None else float(match[1])), text
