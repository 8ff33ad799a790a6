"""The command `drivetwin`."""

import os
import signal
import sys

from . import _native


def main():
    """Runs the command with the arguments of this process, and ends it as the binary ends."""
    # Python's own handler would only note the signal, until the command has ended.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    code = _native.command(["drivetwin", *sys.argv[1:]])
    # Neither Python's streams nor its exit handlers have anything to do; a closed stdout is not an error.
    os._exit(code)
