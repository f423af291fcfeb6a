"""The order of questions at length: a rest beside another process, of a root or of an unknown command."""

from __future__ import annotations

import pytest
import test_waiting

from stictionid.model.spec import Spec


@pytest.mark.parametrize(("lagging", "commands"), [(False, ()), (True, (Spec(),))])
def test_a_rest_is_asked_beside_another_process(lagging: bool, commands: tuple[Spec, ...]) -> None:
    test_waiting.test_a_rest_is_asked_beside_another_process(lagging, commands)
