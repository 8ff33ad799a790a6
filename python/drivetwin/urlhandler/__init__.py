"""Drives for pyserial: `serial.serial_for_url("drivetwin://md3")`, without a port of the system.

`import drivetwin` tells pyserial of this package, where pyserial is installed. The URLs are described in
`drivetwin.urlhandler.protocol_drivetwin`.
"""

import itertools
import threading
import urllib.parse

from .._native import Bench

SHARED: "dict[int, Bench]" = {}
"""Benches of the process whose drives have URLs, by number."""

_NUMBERS = itertools.count(1)
_LOCK = threading.Lock()


def url(bench, drive, port):
    """A URL of a port of a drive. Its bench lives as long as the process, or until it is closed."""
    with _LOCK:
        for closed in [number for number, other in SHARED.items() if other.closed]:
            del SHARED[closed]
        number = next((number for number, other in SHARED.items() if other == bench), None)
        if number is None:
            number = next(_NUMBERS)
            SHARED[number] = bench
    return f"drivetwin://?shared={number}&" + urllib.parse.urlencode({"drive": drive, "port": port})
