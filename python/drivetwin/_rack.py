"""A bench with ports, for masters that need them: in a thread of this process, reached through its control API."""

import builtins
import http.client
import json
import urllib.parse
from dataclasses import dataclass
from typing import Optional, Union

from . import _native
from ._errors import Error, UnknownName


def run(what, **options):
    """Runs a kind of drive, or a bench file, with ports, in a thread of this process.

    `options` are those of `drivetwin run`, by their names: `time="manual"`, `line="fast"`, `fast_boot=True`, `address=2`,
    `set={"Speed": 8000}`, `listen=["tcp:127.0.0.1:5020", "pty:"]`. `with run(...) as rack:` ends it.
    """
    return Rack(_native.Server(_arguments(what, options)))


def _arguments(what, options):
    arguments = [str(what)]
    for name, value in options.items():
        option = "--" + name.replace("_", "-")
        if value is None or value is False:
            continue
        if value is True:
            arguments.append(option)
        elif isinstance(value, dict):
            arguments += [f"{option}={register}={_text(of)}" for register, of in value.items()]
        elif isinstance(value, (list, tuple)):
            arguments += [f"{option}={one}" for one in value]
        else:
            arguments.append(f"{option}={value}")
    return arguments


def _text(value):
    return ",".join(map(str, value)) if isinstance(value, (list, tuple)) else str(value)


class _Api:
    """Calls of a control API."""

    def __init__(self, url):
        self._address = urllib.parse.urlsplit(url).netloc

    def call(self, method, *path, body=None, query=None):
        """The answer of a call; JSON as values, anything else as bytes."""
        target = "/api/" + "/".join(urllib.parse.quote(part, safe="") for part in path)
        if query:
            target += "?" + urllib.parse.urlencode(query)
        connection = http.client.HTTPConnection(self._address)
        try:
            data = None if body is None else json.dumps(body)
            connection.request(method, target, data, {"Content-Type": "application/json"})
            answer = connection.getresponse()
            content = answer.read()
        except (OSError, http.client.HTTPException) as error:
            raise Error(f"the bench at {self._address} does not answer: {error}") from error
        finally:
            connection.close()
        if answer.status >= 400:
            try:
                sentence = json.loads(content)["detail"]
            except (ValueError, KeyError):
                sentence = content.decode(errors="replace")
            raise (UnknownName if answer.status == 404 else Error)(sentence)
        if answer.headers.get_content_type() == "application/json":
            return json.loads(content)
        return content


class Rack:
    """A bench with ports. Each call has had its effect when it returns."""

    def __init__(self, server):
        ready = json.loads(server.json)
        self._server = server
        self._devices = {device["name"]: device for device in ready["devices"]}
        self.control = ready["control"]
        """URL of the control API; None if it is off."""
        self._api = _Api(self.control) if self.control else _Off()

    def __getitem__(self, name):
        if name not in self._devices:
            self._api.call("GET", "drives", name)
            raise UnknownName(f"there is no drive '{name}'")
        return RackDrive(self, self._devices[name])

    def __contains__(self, name):
        return name in self._devices

    def __iter__(self):
        return iter(self._devices)

    def __len__(self):
        return len(self._devices)

    @property
    def now(self):
        """Bench time in seconds."""
        return self._api.call("GET", "bench")["time"]["seconds"]

    @property
    def time(self):
        """Time mode: "real", "xN" or "manual"; may be set."""
        return self._api.call("GET", "bench")["time"]["mode"]

    @time.setter
    def time(self, mode):
        self._api.call("PUT", "time", body={"mode": mode})

    def advance(self, seconds):
        """Lets that many seconds of bench time pass, in manual time."""
        self._api.call("POST", "time", "advance", body={"seconds": seconds})

    def line(self, name):
        """The line or TCP port with that name."""
        lines = {line["name"] for line in self._api.call("GET", "buses")}
        if name not in lines:
            self._api.call("PUT", "buses", name, "faults", body={})
        return RackLine(self._api, name)

    def scenario(self, steps):
        """Plays a scenario from now on: the steps of a table [[scenario]] of a bench file."""
        self._api.call("POST", "scenario", body={"steps": steps})

    def trace(self):
        """The recording of the last events, as text for `drivetwin replay`."""
        return self._download("trace").decode()

    def vcd(self):
        """Their waveforms."""
        return self._download("vcd")

    def pcapng(self):
        """Their frames."""
        return self._download("pcapng")

    def _download(self, format):
        return self._api.call("GET", "trace", query={"format": format})

    def close(self):
        """Ends the run: its files are complete then, and its ports closed."""
        self._server.stop()

    def __enter__(self):
        return self

    def __exit__(self, *raised):
        self.close()


class _Off:
    """The API of a rack without one."""

    def call(self, *_arguments, **_options):
        raise Error("the control API is off; leave out control='off'")


@dataclass(frozen=True)
class RackMotion:
    """Motion of a drive's first axis: position in steps or counts, speed per second, current in A, duty -1 to 1."""

    position: int
    speed: float
    moving: bool
    current: float
    duty: float


@dataclass(frozen=True)
class RackRegister:
    """A register in a request."""

    name: str
    value: Optional[Union[int, list]]
    written: bool


@dataclass(frozen=True)
class RackRequest:
    """A message that a drive has received; the fields are those of `drivetwin.Request`."""

    at: float
    port: str
    bytes: builtins.bytes
    text: str
    answer: Optional[builtins.bytes]
    verdict: str
    reason: Optional[str]
    outcome: str
    address: Optional[int]
    function: Optional[int]
    registers: list

    def __str__(self):
        return f"{self.port} <- {self.text} -> {self.outcome}"


class _Named:
    """A mapping of one member of a drive's state."""

    def __init__(self, drive, member):
        self._drive, self._member = drive, member

    def _all(self):
        return self._drive._state()[self._member]

    def keys(self):
        """The names, in the order of the manual."""
        return list(self._all())

    def values(self):
        """The values."""
        return list(self._all().values())

    def items(self):
        """Names and values."""
        return list(self._all().items())

    def get(self, name, default=None):
        """A value, or `default` if there is no such name."""
        return self._all().get(name, default)

    def __contains__(self, name):
        return name in self._all()

    def __iter__(self):
        return iter(self._all())

    def __len__(self):
        return len(self._all())

    def __getitem__(self, name):
        there = self._all()
        if name not in there:
            raise UnknownName(_native.unknown(self._member[:-1], name, list(there)))
        return there[name]


class _Registers(_Named):
    """The registers of a drive, past the bus."""

    def __setitem__(self, name, value):
        self._drive._call("PUT", "registers", name, body={"value": value})


class _Pins(_Named):
    """The pins of a drive."""

    def __setitem__(self, name, level):
        body = {"level": level} if isinstance(level, (str, bool)) else {"volts": level}
        self._drive._call("PUT", "pins", name, body=body)

    def milliamps(self, name, milliamps):
        """Drives a current in mA into an input that measures one."""
        self._drive._call("PUT", "pins", name, body={"milliamps": milliamps})


class RackDrive:
    """A drive with ports."""

    def __init__(self, rack, device):
        self.bench = rack
        self.name, self.kind = device["name"], device["kind"]
        self._ports = device["ports"]

    def _call(self, method, *path, **more):
        return self.bench._api.call(method, "drives", self.name, *path, **more)

    def _state(self):
        return self._call("GET")

    @property
    def ports(self):
        """Names of the ports."""
        return list(self._ports)

    def uris(self, port=None):
        """All addresses of a port, the first one if none is named."""
        port = self.ports[0] if port is None else port
        if port not in self._ports:
            raise UnknownName(_native.unknown("port", port, self.ports))
        return list(self._ports[port])

    def uri(self, port=None):
        """The first address of a port: "tcp:127.0.0.1:40123"."""
        uris = self.uris(port)
        if not uris:
            raise Error(f"{port or self.ports[0]} of {self.name} has no address")
        return uris[0]

    @property
    def pty(self):
        """Path of the first pty of the drive."""
        found = [uri for uris in self._ports.values() for uri in uris if uri.startswith("pty:")]
        if not found:
            raise Error(f"{self.name} has no pty; give it one with listen='pty:'")
        return found[0][len("pty:") :]

    @property
    def registers(self):
        """The registers, by the manual's names."""
        return _Registers(self, "registers")

    @property
    def pins(self):
        """The pins, by the manual's names."""
        return _Pins(self, "pins")

    @property
    def leds(self):
        """The lights: True while lit."""
        return self._state()["leds"]

    @property
    def faults(self):
        """Faults by name: True while the cause is present."""
        return self._state()["faults"]

    @property
    def powered(self):
        """True while the drive has power."""
        return self._state()["powered"]

    @property
    def motion(self):
        """Motion of the first axis."""
        motion = self._state()["motion"]
        if motion is None:
            raise Error(f"{self.name} moves nothing: {self.kind} has no axis")
        return RackMotion(**motion)

    def encoder(self, counts, hz):
        """Turns the encoder at the inputs A and B by `counts` edges, `hz` of them per second of bench time."""
        self._call("POST", "encoder", body={"counts": counts, "hz": hz})

    def pulse(self, pin, count, hz, duty=0.5):
        """Sends a train of pulses into an input pin, `hz` of them per second of bench time."""
        self._call("POST", "pins", pin, "pulses", body={"count": count, "hz": hz, "duty": duty})

    def fault(self, name):
        """Sets the cause of a fault."""
        self._call("PUT", "faults", name, body={})

    def clear(self, name):
        """Clears the cause of a fault."""
        self._call("DELETE", "faults", name)

    def power(self, action):
        """Switches the power: "off", "on", "cycle" or "cut"."""
        self._call("POST", "power", body={"action": action})

    def line(self, port=None):
        """The line or TCP port of a port, the first one if none is named."""
        port = self.ports[0] if port is None else port
        self.uris(port)
        for line in self.bench._api.call("GET", "buses"):
            if self.name in line["drives"] and line["name"] in (port, f"{self.name}.{port}"):
                return RackLine(self.bench._api, line["name"])
        for line in self.bench._api.call("GET", "buses"):
            if self.name in line["drives"] and line["line"] is not None:
                return RackLine(self.bench._api, line["name"])
        raise Error(f"{port} of {self.name} has no line")

    def received(self, since=0.0, function=None, register=None):
        """The latest messages that the drive has received, the oldest first."""
        query = {"since": since, "function": function, "register": register}
        answer = self._call("GET", "received", query={name: is_ for name, is_ in query.items() if is_ is not None})
        return [_request(request) for request in answer["requests"]]

    def __repr__(self):
        return f"<RackDrive {self.name} ({self.kind})>"


def _request(request):
    answer = request["answer"]
    return RackRequest(
        **{
            **request,
            "bytes": bytes.fromhex(request["bytes"]),
            "answer": None if answer is None else bytes.fromhex(answer),
            "registers": [RackRegister(**register) for register in request["registers"]],
        }
    )


class RackLine:
    """A line or TCP port."""

    def __init__(self, api, name):
        self._api, self.name = api, name

    def faults(self, **faults):
        """Sets the faults of the line from its next frame on; without an argument it has none."""
        self._api.call("PUT", "buses", self.name, "faults", body=faults)
