"""A party line of MDrives: a pty for programs that need a serial port, and on it the MCode ports of drives, as an RS-422
line with several drives has it."""

import contextlib
import os
import select
import socket
import threading
import tty

from mdrive import Terminal


@contextlib.contextmanager
def party_line(*ports):
    """The path of a pty whose bytes go to all these TCP ports, and to which the answers of all come."""
    master, slave = os.openpty()
    tty.setraw(slave)
    stop, stopped = os.pipe()
    drives = [socket.create_connection(port) for port in ports]

    def carry():
        while True:
            ready, _, _ = select.select([stop, master, *drives], [], [])
            if stop in ready:
                return
            if master in ready:
                bytes_ = os.read(master, 4096)
                for drive in drives:
                    drive.sendall(bytes_)
            for drive in drives:
                if drive in ready:
                    os.write(master, drive.recv(4096))

    bridge = threading.Thread(target=carry)
    bridge.start()
    try:
        yield os.ttyname(slave)
    finally:
        os.write(stopped, b"x")
        bridge.join()
        for drive in drives:
            drive.close()
        for end in (master, slave, stop, stopped):
            os.close(end)


def set_up(drivetwin, drive, lines):
    """Downloads lines to a drive as a terminal does, one behind the prompt of the other, puts it into party mode and
    activates that."""
    terminal = Terminal(drivetwin, drive)
    for line in lines:
        terminal.ask(line)
    terminal.socket.sendall(b"PY 1\r")
    terminal.receive_until(b">")
    terminal.socket.sendall(b"\n")
    drivetwin.notice()
    terminal.close()
