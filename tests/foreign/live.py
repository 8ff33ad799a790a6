"""A reader of `/api/live`, by a program that has only HTTP."""

import json
import time
import urllib.request

from conftest import PATIENCE


class Live:
    """A client that has the state of the bench as `/api/live` tells it."""

    def __init__(self, control, query=""):
        self.answer = urllib.request.urlopen(f"{control}/api/live{query}", timeout=PATIENCE)
        assert self.answer.headers["Content-Type"] == "text/event-stream"
        self.state, self.traffic, self.updates = {}, [], 0

    def update(self):
        """Takes the next update."""
        fields = {}
        while (line := self.answer.readline().decode()) != "\n":
            assert line, "the bench is gone"
            name, _, value = line.rstrip("\n").partition(": ")
            fields[name] = value
        if "event" in fields:
            assert fields["event"] == "update"
            update = json.loads(fields["data"])
            assert update, "an update has something"
            self.state = patched(self.state, update.get("state", {}))
            self.traffic += update.get("traffic", [])
            self.updates += 1

    def until(self, wanted):
        """Takes updates until the state is as wanted."""
        until = time.monotonic() + PATIENCE
        while not wanted(self):
            assert time.monotonic() < until, f"it does not come: {self.state}"
            self.update()

    def close(self):
        self.answer.close()


def patched(target, patch):
    """Section 2 of RFC 7396."""
    if not isinstance(patch, dict):
        return patch
    target = dict(target) if isinstance(target, dict) else {}
    for name, value in patch.items():
        if value is None:
            target.pop(name, None)
        else:
            target[name] = patched(target.get(name), value)
    return target


def without_nulls(value):
    """JSON without members that are null, which a live state does not have."""
    if not isinstance(value, dict):
        return value
    return {name: without_nulls(member) for name, member in value.items() if member is not None}
