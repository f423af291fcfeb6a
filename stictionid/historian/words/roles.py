"""Synonyms of column names: roles (SP, PV, OP, …) by common names and by the tag suffixes of the vendors.

A tag is a loop's name and a suffix (FIC101.SP, \\\\SERVER\\FIC101.PV, 2411FIC20102.MV, FT_211 with FV_211).
"""

from __future__ import annotations

import difflib
import functools
import re
from collections.abc import Iterable
from dataclasses import dataclass, replace

from ...errors import DataError
from .cells import brief, shown
from .units import TIED

_WORDS = {
    "setpoint": """
        sp, sv, spt, setpoint, set point, spv, speu, wsp, csp, sp cv, sp out, r, w, ref, reference, target, sollwert,
        soll, consigne, уставка, задание, 设定值, 设定, 設定値, 给定值, lsp, rsp, spo
    """,
    "output": """
        op, out, co, mv, lmn, cveu, output, controller output, control output, out cv, opeu, mv out, u, cvout,
        valve command, valve cmd, demand, stellgröße, stellgrösse, ausgang,
        stellwert, sortie, выход, 输出, 输出值, 操作量, cv,
        out pct, manipulated variable, valve demand, ctrl out, op out
    """,
    "process_value": """
        pv, meas, measurement, process value, process variable, pveu, pv in, pv out, y, istwert, ist, pv cv, mesure,
        значение, 测量值, 测量, 測定値, pvi, measured value, actual, x
    """,
    "position": """
        zt, zi, gt, rb, pos, position, readback, read back, travel, stem, stem position, valve position, valve travel,
        zt pv, zi pv, stellung, ventilstellung, position feedback, pos fb, actual position, positioner, recopie,
        положение, 阀位, v, x v
    """,
    "mode": """
        mode, mode actual, mode act, modeact, ma, mode pv, auto man, automan,
        am, betriebsart, режим, 模式, block mode,
        ctrl mode, controller mode, mode cv, automan, auto, in auto, auto on, is auto, auto mode, automatik, automatic,
        man, manual, in manual, hand, manuell, авто, ручн, 自动, 手动
    """,
    "time": """
        time, timestamp, time stamp, datetime, date time, t, t s, time s, zeit, zeitstempel, zeitpunkt, datum zeit,
        horodatage, date heure, heure, fecha hora, hora, время, дата время,
        метка времени, 时间, 时间戳, 日時, 日付時刻, ts, date,
        datum, fecha, дата, 日期, local time, utc time, time utc, epoch, utc, seconds, sec, elapsed, elapsed s,
        elapsed time, time min, t min, time ms, t ms, time h, t h, source time, timestamp utc, uhrzeit, timestamp ms,
        time sec, date and time, sample time, record time, scan time, jour, stamp
    """,
    "quality": """
        quality, status, qual, confidence, conf, good, questionable, used, quality code, opc quality, qualität,
        качество, 质量, validity, q
    """,
    "tag": """
        tag, tagname, tag name, point, point name, pointname, item, itemid, item id, variable, sensor, series, name,
        metric, signal, channel, messstelle, тег, 位号, tagid, history item
    """,
    "value": """
        value, val, wert, valeur, valor, значение, 值, reading, avg, average, numeric value
    """,
    "loop": """
        loop, loop id, loop name, loopname, controller, regelkreis, block, control loop, loop tag
    """,
    "ignored": """
        id, index, row, no, nr, n, rowid, row id, unnamed, unnamed 0, level 0, segment, sequence
    """,
}
"""Names and suffixes of each role, lower case, separators as blanks, surest first."""
_LOOKUP: dict[str, tuple[str, int]] = {}
for _role, _names in _WORDS.items():
    for _rank, _word in enumerate(w.strip() for w in _names.split(",")):
        _LOOKUP.setdefault(_word, (_role, _rank))

_ISA = re.compile(r"(?P<area>.*?)(?P<letters>[A-Z]{2,5})[-_ ]?(?P<number>\d{1,7}[A-Z]?)\Z", re.IGNORECASE)
_ISA_ROLES = (
    (r"[A-Z]D?I?T\Z", "process_value"),
    (r"[A-Z]C?V\Z", "output"),
    (r"[A-Z]Y\Z", "output"),
    (r"ZI?T?\Z|G[TI]\Z", "position"),
)
_TIED = re.compile(rf"(?P<head>.*?[^\s_,\-])(?:[\s_,\-]+(?:in\s+)?(?P<unit>{TIED})|(?P<mark>%))\s*\Z", re.IGNORECASE)
_SIGNALS = ("setpoint", "process_value", "output", "position")
_MEASURED = "FPLTAQDMSJ"
"""First letters of ISA 5.1: flow, pressure, level, temperature, analysis, quantity, density, moisture, speed, power."""


@dataclass(frozen=True, slots=True)
class Tag:
    """Parts of a column name: `role` or None, the `loop` it belongs to ("" if not named), `rank` (lower is surer)."""

    name: str
    role: str | None
    loop: str
    rank: int
    why: str


@functools.lru_cache(maxsize=20_000)
def tidy(name: str) -> str:
    """A column name without unit, quotes, case and separators."""
    bare = re.sub(r"[\[(][^\])]*[\])]\s*$", "", name.strip().strip("\"'")).strip()
    bare = re.sub(r"(?<=[a-z]{2})(?=[A-Z][a-z])", " ", bare)
    return re.sub(r"[\s_\-./\\:|!]+", " ", bare).strip().lower()


def role_of(name: str) -> str | None:
    """The role that a column name indicates, or None."""
    return take_apart(name).role


@functools.lru_cache(maxsize=20_000)
def take_apart(name: str) -> Tag:
    """Role and loop of a column name, by its suffix, by its whole text, or by its instrument letters."""
    bare = re.sub(r"[\[(][^\])]*[\])]\s*$", "", name.strip().strip("\"'")).strip()
    text = tidy(name)
    if text in _LOOKUP:
        role, rank = _LOOKUP[text]
        return Tag(name, role, "", rank, f"name {text!r}")
    tied = _TIED.match(bare)
    if tied and (tag := take_apart(tied["head"])).role in _SIGNALS:
        return replace(tag, name=name)
    words = text.split(" ")
    for take in (3, 2, 1):
        suffix = " ".join(words[-take:])
        if len(words) > take and suffix in _LOOKUP:
            role, rank = _LOOKUP[suffix]
            bare_letter = len(suffix) == 1 and not any(map(str.isdigit, words[0]))
            if role not in ("tag", "value", "loop", "ignored") and not bare_letter:
                return Tag(name, role, _loop_before(bare, suffix), rank, f"suffix {suffix!r}")
    first = re.match(r"(sp|pv|op|mv|sv|co|out|mode|setpoint|output)[ ](.+)\Z", text)
    if first:
        role, rank = _LOOKUP[first.group(1)]
        return Tag(name, role, re.sub(r"^[A-Za-z]+[\s_\-./\\:|!]+", "", bare), rank + 50, f"prefix {first.group(1)!r}")
    return _by_instrument(name, bare)


def unit_in(name: str) -> str:
    """The unit in a column name: "FIC-101.PV (m3/h)" has m3/h, "OP mA" has mA; "FIC101.MA" is a mode and has none."""
    match = re.search(r"[\[(]([^\])]{1,15})[\])]\s*$", name)
    if match:
        return match.group(1).strip()
    tied = _TIED.match(name.strip().strip("\"'"))
    if not tied:
        return ""
    unit = tied["unit"] or tied["mark"]
    return unit if unit == "mA" or take_apart(tied["head"]).role in _SIGNALS else ""


def take_all(names: Iterable[str]) -> list[Tag]:
    """Parts of all column names of a table; Y beside another process value, without an output, is the output.

    DIN 19227 calls the controller output Y, beside W and X. Elsewhere y is the process value, beside r and u.
    """
    tags = [take_apart(name) for name in names]

    def near(tag: Tag, role: str) -> list[Tag]:
        digits = re.sub(r"\D", "", tag.loop)
        return [other for other in tags if other.role == role and (
            tidy(other.loop) == tidy(tag.loop) or (digits and re.sub(r"\D", "", other.loop) == digits))]

    def is_output(tag: Tag) -> bool:
        return (tag.role == "process_value" and tag.why.endswith(" 'y'") and not near(tag, "output")
                and any(other.why != tag.why for other in near(tag, "process_value")))

    return [replace(tag, role="output", why=f"{tag.why} beside another process value") if is_output(tag) else tag
            for tag in tags]


def _loop_before(bare: str, suffix: str) -> str:
    """The part of a tag before its suffix, without server, slot names and trailing separators."""
    pattern = r"[\s_\-./\\:|!]*".join(re.escape(w) for w in suffix.split(" "))
    head = re.sub(rf"[\s_\-./\\:|!]*{pattern}\Z", "", bare, flags=re.IGNORECASE)
    head = re.sub(r"[./:](?:PIDA?|DACA|PID\d*|AO|AI|FC|CTL)\Z", "", head, flags=re.IGNORECASE)
    return re.split(r"[\\|]", head.rstrip("./\\:|! "))[-1].lstrip("/")


def _by_instrument(name: str, bare: str) -> Tag:
    match = _ISA.match(re.split(r"[\\/|.:]", bare)[-1])
    if match:
        letters = match.group("letters").upper()
        for pattern, role in _ISA_ROLES:
            if re.match(pattern, letters) and (role == "position" or letters[0] in _MEASURED):
                return Tag(name, role, match.group("number"), 20, f"instrument letters {letters}")
    return Tag(name, None, "", 99, "")


# Column names in a message.
_MOST_NAMES = 12
_ONE_SIGNAL = ("--sp", "--pv", "--op", "--position", "--mode", "--extra")
"""Options whose column is one signal: two columns of its name are two signals."""


def pick(names: tuple[str, ...], wanted: str, option: str, file: str) -> int:
    """Index of the column that an option names: exactly, without case and separators, or by its 1-based number."""
    same = [i for i, n in enumerate(names) if n == wanted]
    if len(same) > 1 and option in _ONE_SIGNAL:
        numbers = " and ".join(str(i + 1) for i in same[:3]) + ("" if len(same) < 4 else " and more")
        raise DataError(f"{file} has {len(same)} columns named {shown(wanted)}, number {numbers}",
                        f"choose by number: {option} {same[0] + 1} or {option} {same[1] + 1}")
    if same:
        return same[0]
    alike = [i for i, n in enumerate(names) if tidy(n) == tidy(wanted) or n.strip().lower() == wanted.strip().lower()]
    if len(alike) == 1:
        return alike[0]
    if wanted.strip().isdecimal() and len(wanted) < 10 and 1 <= int(wanted) <= len(names):
        return int(wanted) - 1
    near = difflib.get_close_matches(wanted, names, n=1, cutoff=0.5)
    more = f"; nearest: {shown(near[0])}" if near else ""
    kind = "more than one column" if alike else "no column"
    raise DataError(f"{file} has {kind} {shown(wanted)} for {option}{more}", f"columns: {listing(names)}")


def listing(names: tuple[str, ...] | list[str]) -> str:
    """Column names for a message, at most a dozen, each on one line and cut where it is long."""
    shown = [brief(n) or f"(unnamed {i + 1})" for i, n in enumerate(names[:_MOST_NAMES])]
    return ", ".join(shown) + (f", … {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else "")
