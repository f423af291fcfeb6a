"""Template of a user-written law: friction that builds up while the stem rests."""

from __future__ import annotations

_TEMPLATE = '''"""Valve whose static friction builds up while the stem rests.

|command - position| > f_d + (f_s - f_d)(1 - exp(-rest / DWELL)): the stem moves to f_d beside the command.
"""

import math

NAME = "{name}"
# Samples of rest after which 63 % of the static friction is back.
DWELL = 5.0
# Numbers that the law remembers beside the position, as they are at the start: here the samples of rest so far.
MEMORY = (100.0,)


# One sample. `command` and `before` are this command and the last one, `position` is the stem's, all in %. f_s is the
# force at break-away, f_d that of sliding: S = f_s + f_d, J = f_s - f_d. Return the new position. `memory` is an array
# that you may change; nothing else is remembered. Plain numbers and the module math compile.
def step(command, before, position, memory, f_s, f_d):
    force = command - position
    if abs(force) > f_d + (f_s - f_d) * (1.0 - math.exp(-memory[0] / DWELL)):
        memory[0] = 0.0
        return command - f_d if force > 0.0 else command + f_d
    memory[0] += 1.0
    return position
'''


def template(name: str) -> str:
    """The text of a file with a law of this name whose friction builds up at rest."""
    return _TEMPLATE.format(name=name)
