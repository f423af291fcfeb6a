"""Loops that swing with the same period, and which of them may be the source of the swing.

The source is looked for among the loops whose valve sticks: the one with the strongest harmonics, and of two alike the
one that is first. A candidate, not a proof: a test in manual of that loop tells. Where the export held the other loops
(--extra '*'), the tags that drive the group's loops confirm the source, or name others.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

Row = dict[str, Any]

SOURCE, STICKS, FOLLOWS = "may be the source", "sticks too", "follows"
# Largest difference of two periods in a group, as a share of the period and in cycles of the shorter record.
_SHARE, _CYCLES = 0.01, 0.25
# Harmonics within this factor of the strongest count as alike.
_ALIKE = 1.5
_DAY_S = 86_400.0


def grouped(rows: Sequence[Row]) -> list[Row]:
    """The rows with `group` (1, 2, …, the largest first) and `role`; None for a loop that swings alone."""
    swinging = sorted((r for r in rows if r.get("rhythm")), key=lambda r: (r["rhythm"]["period_s"], r["loop"]))
    groups: list[list[Row]] = []
    for row in swinging:
        if groups and _together(groups[-1][0]["rhythm"], row["rhythm"]):
            groups[-1].append(row)
        else:
            groups.append([row])
    shared = sorted((g for g in groups if len(g) > 1), key=lambda g: (-len(g), g[0]["loop"]))
    told = {id(row): {"group": number, "role": role} for number, group in enumerate(shared, 1)
            for row, role in zip(group, _roles(group), strict=True)}
    return [{**row, **told.get(id(row), {"group": None, "role": None})} for row in rows]


def groups_said(rows: Sequence[Row]) -> list[str]:
    """One sentence a group."""
    said = []
    for number in sorted({row["group"] for row in rows if row["group"]}):
        group = [row for row in rows if row["group"] == number]
        period = sorted(row["rhythm"]["period_s"] for row in group)[len(group) // 2]
        first = next((row for row in group if row["role"] == SOURCE), None)
        begin = f"Group {number}: {len(group)} loops swing with {period:.3g} s"
        if first is None:
            said.append(f"{begin}; no valve among them is found to stick, so the source may lie elsewhere.")
            continue
        others = [row for row in group if row is not first]
        strongest = first["rhythm"]["harmonics"] >= max(row["rhythm"]["harmonics"] for row in others)
        why = "its valve sticks" + (" and its harmonics are the strongest" if strongest else "")
        why += ", and it is the first to swing" if earliest(group) is first else ""
        also = [row["loop"] for row in others if row["role"] == STICKS]
        said.append(f"{begin}; {first['loop']} may be the source ({why})" + (
            f"; {', '.join(also)} {'sticks' if len(also) == 1 else 'stick'} too" if also else "")
                    + _driven(first, others) + ".")
    return said


def _driven(source: Row, others: Sequence[Row]) -> str:
    """The loops of a group that a tag of the source drives, and those that another tag drives; empty without any."""
    drivers = {row["loop"]: str(row.get("driver") or "") for row in others if row.get("driver")}
    mine = [loop for loop, tag in drivers.items() if _of_loop(tag, source["loop"])]
    apart = [f"{loop} by {tag}" for loop, tag in drivers.items() if loop not in mine]
    return (f"; its tags drive {', '.join(mine)}, which confirms it" if mine else "") + (
        f"; other tags drive {', '.join(apart)}" if apart else "")


def _of_loop(tag: str, loop: str) -> bool:
    """True for a tag whose name begins with that of a loop and goes on with a separator or ends."""
    head, rest = tag[:len(loop)], tag[len(loop):]
    return head.casefold() == loop.casefold() and not rest[:1].isalnum()


def _together(a: dict[str, Any], b: dict[str, Any]) -> bool:
    """True where two rhythms have one period, and were recorded within a day of each other."""
    apart = abs(a["period_s"] / b["period_s"] - 1.0)
    at = (a["middle_s"], b["middle_s"])
    same_time = None in at or abs(at[0] - at[1]) < _DAY_S
    return same_time and apart <= max(_SHARE, _CYCLES / min(a["cycles"], b["cycles"]))


def _roles(group: Sequence[Row]) -> list[str]:
    sticking = [row for row in group if row["verdict"] == "stiction"]
    strongest = max((row["rhythm"]["harmonics"] for row in sticking), default=0.0)
    alike = [row for row in sticking if row["rhythm"]["harmonics"] * _ALIKE >= strongest]
    first = (earliest(alike) or max(alike, key=lambda row: row["rhythm"]["harmonics"])) if alike else None
    return [SOURCE if row is first else STICKS if any(row is s for s in sticking) else FOLLOWS for row in group]


def earliest(group: Sequence[Row]) -> Row | None:
    """The loop whose swing comes first, on the circle of one period behind its widest gap; None where that is unknown.

    All records need stamps, and the phases must not be spread over more than half a period.
    """
    if len(group) < 2:
        return group[0] if group else None
    if any(row["rhythm"]["middle_s"] is None for row in group):
        return None
    period = sum(row["rhythm"]["period_s"] for row in group) / len(group)
    at = group[0]["rhythm"]["middle_s"]
    # The phase of a loop that lags is smaller; later in the list is later in time.
    lag = sorted(((-(row["rhythm"]["phase"] + (at - row["rhythm"]["middle_s"]) / period)) % 1.0, i)
                 for i, row in enumerate(group))
    gaps = [((lag[(k + 1) % len(lag)][0] - lag[k][0]) % 1.0, (k + 1) % len(lag)) for k in range(len(lag))]
    widest, start = max(gaps)
    return group[lag[start][1]] if widest >= 0.5 else None
