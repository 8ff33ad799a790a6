from collections.abc import Sequence

from . import Bench as Bench
from . import Drive as Drive
from . import Line as Line
from . import Motion as Motion
from . import Motor as Motor
from . import Pins as Pins
from . import Port as Port
from . import Registers as Registers
from . import Request as Request
from . import RequestRegister as RequestRegister
from . import kinds as kinds

__all__ = [
    "__version__",
    "command",
    "kinds",
    "end_runs",
    "panic_for_test",
    "Bench",
    "Drive",
    "Registers",
    "Pins",
    "Line",
    "Port",
    "Motion",
    "Motor",
    "Request",
    "RequestRegister",
]

__version__: str

def command(arguments: Sequence[str]) -> int: ...
def end_runs() -> None: ...
def panic_for_test(bench: Bench) -> None: ...
