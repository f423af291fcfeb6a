"""System states that historians write in place of a number, as words and as numeric codes."""

from __future__ import annotations

import re

SYSTEM_STATES = frozenset(w.strip() for w in """
bad|bad input|bad data|bad quality|bad value|i/o timeout|io timeout|no data|nodata|no value|
no sample|scan off|scan timeout|configure|pt created|point created|shutdown|over range|under range|
overrange|underrange|calc failed|calc timeout|comm fail|comm failure|comm error|not connect|
not connected|arc off-line|arc offline|arc off line|no good data for calculation|tag not found|
resize to show all values|point not found|no result|no alarm|access denied|unit down|snapshot fail|
snapshotf fail|failed|fail|error|err|invalid|uncertain|questionable|none|null|nan|na|n/a|n.a.|
inf|-inf|+inf|infinity|-infinity|neginf|posinf|missing|-|--|---|?|*|1.#ind|-1.#ind|1.#inf|
-1.#inf|1.#qnan|-1.#qnan|#n/a|#value!|#ref!|#div/0!|#name?|#num!|#null!|digital state|sys failed|
inp ovrange|out of serv|out of service|intf shut|trace off|equip fail|dcs failed|future data|stopped|
off-line|offline|timeout|disconnected|stale|substituted|last known|schlecht|ungültig|fehler|
kein wert|störung|mauvais|invalide|erreur|malo|no bueno|нет данных|ошибка|недостоверно|плохое|坏值|
无数据|错误|通讯中断|不良|データなし|欠測|good|annotated
""".replace("\n", "").split("|") if w.strip())
"""Lower-case words: digital states of the PI system, texts of IP.21, PHD and OPC, errors of Excel."""

NUMERIC_STATES = range(193, 256)
"""Codes of the PI system digital-state set that collectors write as numbers (for example 253 "Pt Created")."""

SENTINELS = (
    -9999.0,
    9999.0,
    -99999.0,
    99999.0,
    -999.25,
    -99.125,
    -999.0,
    -9999.25,
    1e30,
    -1e30,
    1e20,
    -1e20,
    -32768.0,
    32767.0,
    3.4028234663852886e38,
    -3.4028234663852886e38,
    1e38,
    -1e38,
    999999.0,
    -999999.0,
)
"""Numbers that mean "no value" (loggers, LAS, WITSML, single-precision limits); believed only where far outside."""

_BRACKETED = re.compile(r"\[-?\d+\]\s*")


def is_state(cell: str) -> bool:
    """True for a known system state, whatever its case, brackets or leading number."""
    return bool(cell) and tidy(cell) in SYSTEM_STATES


def tidy(cell: str) -> str:
    """A state word in the form of the list: lower case, one blank, no brackets or leading error number."""
    return re.sub(r"\s+", " ", _BRACKETED.sub("", cell).strip(" <>()[]\"'").lower().replace("_", " "))
