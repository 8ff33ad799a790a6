"""`Bench.plot`: what happened on a bench, as a matplotlib figure."""

import textwrap

from ._errors import Error

# Widths and heights in inches.
_WIDTH, _LEFT, _RIGHT = 12.0, 1.75, 0.3
_TOP, _BOTTOM, _HEADING, _GAP = 0.62, 0.5, 0.42, 0.14
_HEIGHTS = {"position": 1.3, "speed": 0.95, "current": 0.75, "duty": 0.75, "volts": 0.65}
_PIN, _MARKS, _ROW = 0.27, 0.3, 0.17
_LINE, _LEGEND = 0.24, 0.32

_TITLE = 80
"""Characters of a line of the title; those of the widest of usual fonts fill the figure."""
_BESIDE_LEGEND = 40
"""Characters of a title that has the legend beside it."""

_ROWS = 5
"""Rows of words of frames."""
_CROWD = 40
"""Frames above which equal reads are named once."""
_LONGEST = (100, 56)
"""Characters of the words of a frame: where there is room, and elsewhere."""
_COLUMN = 1 / 2_000
"""Width of a column with many edges, as a share of the time axis."""

_INK, _GREY, _GRID = "#0f172a", "#64748b", "#e2e8f0"
_CURVES = {
    "position": "#2563eb", "speed": "#059669", "current": "#d97706", "duty": "#7c3aed", "volts": "#0891b2",
}  # fmt: skip
_UNITS = {"current": "A", "duty": "of full on", "volts": "V"}
_REQUEST, _ANSWER, _PINS, _MANY = "#0284c7", "#7dd3fc", "#475569", "#94a3b8"
# Colour and sign: each outcome can be told without its colour.
_OUTCOMES = {
    "done": (_REQUEST, None),
    "refused": ("#dc2626", "s"),
    "without effect": ("#d97706", "^"),
    "not received": (_INK, "x"),
    "by fault": ("#a21caf", "D"),
}


def plot(bench, drives, start, end, title):
    """The figure of `Bench.plot`."""
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise Error("a plot needs matplotlib: pip install 'drivetwin[plot]'") from error
    span = (0.0 if start is None else start, bench.now if end is None else end)
    rows = []
    outcomes = []
    for panel in bench._tracks(drives, start, end):
        rows += _rows(panel, span, outcomes)
    title = _lines("drivetwin" if title is None else title)
    legend = _LEGEND if outcomes and (len(title) > 1 or len(title[0]) > _BESIDE_LEGEND) else 0.0
    above = _TOP + _LINE * (len(title) - 1) + legend
    height = above + _BOTTOM + sum(row.height + _GAP for row in rows)
    figure = Figure(figsize=(_WIDTH, height), facecolor="white")
    top, axes = height - above, None
    last = next((row for row in reversed(rows) if row.draw is not None), None)
    for row in rows:
        box = (_LEFT / _WIDTH, (top - row.height) / height, (_WIDTH - _LEFT - _RIGHT) / _WIDTH, row.height / height)
        if row.draw is None:
            _heading(figure, row, (top - 0.27) / height)
        else:
            axes = figure.add_axes(box, sharex=axes)
            _frame(axes, row)
            row.draw(axes)
            axes.set_xlim(*span)
        top -= row.height + _GAP
        if row is last:
            # The labels of the time axis. Below are headings of drives without tracks.
            top -= _BOTTOM
    if not rows:
        figure.text(_LEFT / _WIDTH, 0.5, "nothing happened", color=_GREY, fontsize=9)
    if axes is not None:
        axes.tick_params(axis="x", labelbottom=True, labelsize=8, labelcolor=_INK)
        axes.set_xlabel("time in s", fontsize=9, color=_INK)
    for number, line in enumerate(title):
        y = 1 - (0.38 + _LINE * number) / height
        figure.text(0.2 / _WIDTH, y, line, fontsize=13, fontweight="bold", color=_INK)
    if outcomes:
        _legend(figure, outcomes, 1 - (0.12 + (above - _TOP)) / height)
    return figure


def _lines(title):
    """The lines of a title."""
    return [line for part in title.splitlines() for line in textwrap.wrap(part, _TITLE)] or [""]


class _Row:
    """A part of the figure: its height, and how it is drawn; a heading is not."""

    def __init__(self, height, name, unit, draw):
        self.height, self.name, self.unit, self.draw = height, name, unit, draw


def _rows(panel, span, outcomes):
    """The parts of a drive: motion, frames, pins."""
    tracks = panel["tracks"]
    rows = [_Row(_HEADING - _GAP, panel["name"], panel["product"] + ("" if tracks else ": nothing happened"), None)]
    for track in tracks:
        kind = track["kind"]
        if kind in _CURVES:
            unit = _UNITS.get(kind, panel["unit"] + ("/s" if kind == "speed" else ""))
            name = track["name"]
            rows.append(_Row(_HEIGHTS[kind], name, unit, _Curve(track, _CURVES[kind])))
    for track in tracks:
        if track["kind"] == "frames":
            frames = _Frames(track["exchanges"], span)
            outcomes += [mark for *_, mark in track["exchanges"] if mark not in outcomes]
            rows.append(_Row(_MARKS + _ROW * frames.count, track["name"], "frames", frames))
    pins = [track for track in tracks if track["kind"] == "level"]
    if pins:
        rows.append(_Row(_PIN * len(pins), "", "", _Pins(pins, span)))
    # Volts are pins, too, so they come last.
    rows.sort(key=lambda row: isinstance(row.draw, _Curve) and row.unit == "V")
    return rows


def _heading(figure, row, y):
    figure.text(0.2 / _WIDTH, y, row.name, fontsize=11, fontweight="bold", color=_INK)
    figure.text(_LEFT / _WIDTH, y, row.unit, fontsize=9, color=_GREY)


def _frame(axes, row):
    axes.set_facecolor("#f8fafc")
    axes.grid(True, axis="x", color=_GRID, linewidth=0.8)
    axes.set_axisbelow(True)
    for spine in axes.spines.values():
        spine.set_color("#cbd5e1")
    axes.tick_params(axis="both", length=0, labelsize=8, labelcolor=_GREY, labelbottom=False)
    # Inches from the left edge of the figure and the top of the row.
    x = (0.2 - _LEFT) / (_WIDTH - _LEFT - _RIGHT)
    for words, below, style in (row.name, 0.13, {"fontweight": "bold"}), (row.unit, 0.31, {"color": _GREY}):
        place = {"transform": axes.transAxes, "va": "center", "fontsize": 9, "color": _INK}
        axes.text(x, 1 - below / row.height, words, **{**place, **style})


class _Curve:
    """A number over time."""

    def __init__(self, track, colour):
        self.track, self.colour = track, colour

    def __call__(self, axes):
        times = [at for at, _ in self.track["curve"]]
        values = [float("nan") if value is None else value for _, value in self.track["curve"]]
        axes.plot(times, values, color=self.colour, linewidth=1.5, solid_joinstyle="round")
        axes.grid(True, axis="y", color=_GRID, linewidth=0.8)
        axes.margins(y=0.1)
        known = [value for value in values if value == value]
        if min(known, default=0) > 0 > min(known) - (max(known) - min(known)):
            axes.set_ylim(bottom=-0.06 * max(known))
        axes.yaxis.set_major_locator(_locator())
        axes.yaxis.set_major_formatter(lambda value, _: f"{value:,.6g}".replace("-", "\u2212"))


def _locator():
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(nbins=4, steps=[1, 2, 5, 10])


class _Pins:
    """Levels of digital pins over time, one below the other."""

    def __init__(self, tracks, span):
        self.tracks, self.span = tracks, span

    def __call__(self, axes):
        count = len(self.tracks)
        for lane, track in enumerate(self.tracks):
            self._draw(axes, track["edges"], count - 1 - lane)
        axes.set_ylim(-0.2, count - 0.05)
        axes.set_yticks([])
        x = (0.2 - _LEFT) / (_WIDTH - _LEFT - _RIGHT)
        for lane, track in enumerate(self.tracks):
            y = count - 1 - lane + 0.33
            axes.text(
                x, y, track["name"], transform=axes.get_yaxis_transform(), va="center", fontsize=9, color=_INK,
                fontweight="bold",
            )  # fmt: skip

    def _draw(self, axes, edges, base):
        low, high, middle = base, base + 0.66, base + 0.33
        column = (self.span[1] - self.span[0]) * _COLUMN
        edges = _joined(edges, column)
        ends = [at for at, _, _ in edges[1:]] + [self.span[1]]
        blocks, unknown, floating, line = [], [], [], ([], [])

        def level(begin, end, y):
            line[0].extend([begin, end])
            line[1].extend([y, y])

        for place, ((at, many, state), end) in enumerate(zip(edges, ends)):
            is_last = place + 1 == len(edges)
            if many:
                # Up to the next column, if it has many edges, too.
                width = end - at if not is_last and edges[place + 1][1] and end - at < 2 * column else column
                blocks.append((at, min(width, end - at)))
                at = min(at + width, end)
                level(at, at, float("nan"))
                if at == end:
                    continue
            if state in "01":
                level(at, end, high if state == "1" else low)
                continue
            level(at, at, float("nan"))
            if state == "z":
                floating.append((at, end))
            else:
                unknown.append((at, end - at))
        axes.plot(*line, color=_PINS, linewidth=1.2)
        axes.broken_barh(blocks, (low, 0.66), facecolor=_MANY, edgecolor=_MANY, linewidth=0.6)
        axes.broken_barh(unknown, (low, 0.66), facecolor=_GRID, linewidth=0)
        for begin, end in floating:
            axes.plot([begin, end], [middle, middle], color=_MANY, linewidth=1.0, linestyle=(0, (3, 3)))


def _joined(edges, column):
    """Edges of which two that are nearer than a column are shown as many, also if a border of columns is between them."""
    joined = edges[:1]
    for at, many, state in edges[1:]:
        # The first one is the level at the begin of the time axis.
        if len(joined) > 1 and at - joined[-1][0] < column:
            before, _, old = joined[-1]
            if many:
                joined[-1:] = [(before, True, old), (at, True, state)]
            else:
                joined[-1] = (before, True, state)
        else:
            joined.append((at, many, state))
    return joined


class _Frames:
    """Messages and answers on a port, with the words of as many as there is room for."""

    def __init__(self, exchanges, span):
        self.exchanges, self.span = exchanges, span
        self.words = list(self._words())
        self.count = 1 + max((row for _, row, *_ in self.words), default=-1)

    def _words(self):
        """Time, row, words, colour and side of the words: of what went wrong first, then of commands, then of reads."""
        groups, before, known = ([], [], []), None, set()
        for request, answer, words, mark in self.exchanges:
            is_read = words.startswith("read ")
            what = words.split(" = ")[0]
            is_new = words != before and not (is_read and len(self.exchanges) > _CROWD and what in known)
            before = words
            known.add(what)
            if is_new:
                groups[0 if mark != "done" else 2 if is_read else 1].append(((request or answer)[0], words, mark))
        begin, end = self.span
        inch = (end - begin) / (_WIDTH - _LEFT - _RIGHT)
        taken = [[] for _ in range(_ROWS)]
        for at, whole, mark in (one for group in groups for one in reversed(group)):
            for words in dict.fromkeys(whole if len(whole) <= most else whole[: most - 1] + "…" for most in _LONGEST):
                # The widest of usual fonts have 0.066 inches for a character of 8 points.
                width = (0.066 * len(words) + 0.15) * inch
                is_left = at + width > end
                place = (at - width, at) if is_left else (at, at + width)
                row = self._free(taken, place)
                if row is not None and place[0] >= begin:
                    taken[row].append(place)
                    yield at, row, words, _OUTCOMES[mark][0], is_left
                    break

    @staticmethod
    def _free(taken, place):
        """The first row in which a place is free."""
        for row, others in enumerate(taken):
            if all(place[1] <= other[0] or other[1] <= place[0] for other in others):
                return row
        return None

    def __call__(self, axes):
        rows = self.count * _ROW / _MARKS
        axes.set_ylim(-rows, 1)
        axes.set_yticks([])
        times = [(request or answer)[0] for request, answer, _, _ in self.exchanges]
        for at, row, words, colour, is_left in self.words:
            y = -(self.count - row - 0.5) * _ROW / _MARKS
            axes.plot([at, at], [y, 0.3], color="#cbd5e1", linewidth=0.8, zorder=1)
            axes.annotate(
                words, (at, y), xytext=(-4 if is_left else 4, 0), textcoords="offset points", fontsize=8,
                va="center", ha="right" if is_left else "left", color="#075985" if colour == _REQUEST else colour,
                zorder=4, bbox={"boxstyle": "square,pad=0.05", "facecolor": "#f8fafc", "edgecolor": "none"},
            )  # fmt: skip
        bars = {_ANSWER: []}
        signs = {}
        for at, (request, answer, _, mark) in zip(times, self.exchanges):
            colour, sign = _OUTCOMES[mark]
            if request:
                bars.setdefault(colour, []).append((request[0], request[1] - request[0]))
            if answer:
                bars[_ANSWER].append((answer[0], answer[1] - answer[0]))
            if sign:
                signs.setdefault(mark, []).append(at)
        for colour, spans in bars.items():
            axes.broken_barh(spans, (0.1, 0.4), facecolor=colour, edgecolor=colour, linewidth=0.9, zorder=2)
        for mark, places in signs.items():
            colour, sign = _OUTCOMES[mark]
            axes.plot(places, [0.75] * len(places), sign, color=colour, markersize=5, markeredgewidth=1.4, zorder=3)


def _legend(figure, outcomes, top):
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles = [Patch(color=_REQUEST, label="request"), Patch(color=_ANSWER, label="answer")]
    for mark, (colour, sign) in _OUTCOMES.items():
        if sign and mark in outcomes:
            handles.append(Line2D([], [], marker=sign, linestyle="", color=colour, markersize=5, label=mark))
    figure.legend(
        handles=handles, loc="upper right", ncols=len(handles), fontsize=8.5, frameon=False, labelcolor=_INK,
        bbox_to_anchor=(1 - _RIGHT / _WIDTH + 0.008, top), handlelength=1.2, columnspacing=1.6,
    )  # fmt: skip
