"""Motion drives for tests: five real products, emulated as their manuals describe them.

    import drivetwin

    bench = drivetwin.Bench()
    x = bench.add("md3", name="x", fast_boot=True)
    x.registers["Speed"] = 8000
    x.ask(bytes.fromhex("010600110001180F"))  # Move, as a Modbus master asks for it
    bench.advance(3.0)
    assert x.motion.position == 10_000

Times are in seconds of bench time, positions in steps or counts, currents in A. A name or value that is not valid raises
`Error` with the sentence that the command `drivetwin` prints.
"""

from ._board import attach
from ._errors import Error, NotOnBoard, UnknownName
from ._native import Bench, Drive, Line, Motion, Motor, Pins, Port, Registers, Request, RequestRegister, kinds
from ._native import __version__
from ._run import run

try:
    import serial
except ImportError:
    pass
else:
    # From now on, serial.serial_for_url("drivetwin://md3") finds the module drivetwin.urlhandler.protocol_drivetwin.
    serial.protocol_handler_packages.append("drivetwin.urlhandler")

__all__ = [
    "Bench",
    "Drive",
    "Error",
    "Line",
    "Motion",
    "Motor",
    "NotOnBoard",
    "Pins",
    "Port",
    "Registers",
    "Request",
    "RequestRegister",
    "UnknownName",
    "attach",
    "kinds",
    "run",
]
