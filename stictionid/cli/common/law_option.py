"""The option of a law: its name, and parameters of its own after a colon, `karnopp:mass=2,spring=60000`."""

from __future__ import annotations

from typing import Any

from ...errors import UsageError

# Friction forces in N, which a physical law takes in place of S and J.
_FORCES = ("F_s", "F_c")


def parse_law(text: str) -> tuple[str, dict[str, float]]:
    """Name and parameters of a law; UsageError where a part is not par=number."""
    name, _, rest = text.partition(":")
    values: dict[str, float] = {}
    for part in filter(None, rest.split(",")):
        key, _, value = part.partition("=")
        try:
            values[key.strip()] = float(value)
        except ValueError:
            raise UsageError(f"the law's '{part}' is not par=number", f"write for example {name}:mass=2 "
                             "(stictionid laws NAME shows a law's parameters)") from None
    return name.strip(), values


def from_forces(law: Any, values: dict[str, float]) -> tuple[tuple[float, float] | None, dict[str, float]]:
    """S and J in % where the parameters hold F_s and F_c in N (else None), and the parameters without these.

    Raises ModelError for F_s < F_c and F_c < 0, and UsageError for one of the two alone.
    """
    given = [name for name in _FORCES if name in values]
    rest = {name: value for name, value in values.items() if name not in _FORCES}
    if not given or law.searchable:
        return None, values
    if len(given) == 1:
        raise UsageError(f"{given[0]} alone does not say what S and J are", "give both, F_s=…,F_c=…, or --S and --J")
    from ...laws.physical import stiction_of

    chosen = {**law.defaults, **rest}
    return stiction_of(values["F_s"], values["F_c"], spring=chosen["spring"], travel=chosen["travel"]), rest


def forces(law: Any, S: float, J: float, values: dict[str, float]) -> tuple[float, float] | None:
    """F_s and F_c in N of a physical law with S and J in %; None for the others."""
    if law.searchable:
        return None
    from ...laws.physical import forces_of

    chosen = {**law.defaults, **values}
    return forces_of(S, J, spring=chosen["spring"], travel=chosen["travel"])
