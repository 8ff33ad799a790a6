"""The pyserial URL of a board's port behind RFC 2217, as `drive.url()` has it: `drivetwin_rfc2217://HOST:PORT`.

The port is that of `rfc2217://`, which refuses to open with a timeout of writes. pymodbus opens every port with one.
"""

from serial import rfc2217


class Serial(rfc2217.Serial):
    """A serial port over TCP without a timeout of writes."""

    @property
    def write_timeout(self):
        """None: a write waits as long as TCP does."""
        return None

    @write_timeout.setter
    def write_timeout(self, seconds):
        pass


def serial_class_for_url(url):
    """The URL and the class for `serial.serial_for_url`."""
    _, _, place = url.partition("://")
    return f"rfc2217://{place}", Serial
