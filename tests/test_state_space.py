"""Linear elements in series with the process: against lags, against Runge-Kutta, and their start-up."""

from __future__ import annotations

import naive
import numpy as np
import pytest

from stictionid.process.linear import Dynamics, free_run
from stictionid.process.state_space import Element, Stepped, element_of, modes

RNG = np.random.default_rng(3)
T1, L, T2 = np.array([3.0, 8.0, 15.0]), np.array([0.0, 2.3, 5.0]), np.array([2.0, 5.0, 1.0])
NONE = np.zeros(3)


def path(rows: int, lanes: int = 3) -> np.ndarray:
    return 50.0 + np.cumsum(RNG.standard_normal((rows, lanes)) * (RNG.random((rows, lanes)) < 0.1), axis=0)


def lag(T: np.ndarray) -> Element:
    return element_of(np.stack([0.0 * T, 1.0 + 0.0 * T]), np.stack([T, 1.0 + 0.0 * T]))


@pytest.mark.parametrize("integrating", [False, True])
@pytest.mark.parametrize(("substeps", "ahead"), [(1, False), (4, False), (4, True)])
def test_a_lag_as_an_element_is_a_second_lag(integrating: bool, substeps: int, ahead: bool) -> None:
    position = path(200 * substeps)
    more = {"step_s": 1.5, "substeps": substeps, "ahead": ahead}
    want = free_run(position, Dynamics(T1, L, T2, integrating), **more)
    got = free_run(position, Dynamics(T1, L, NONE, integrating, (lag(T2),)), **more)
    np.testing.assert_allclose(got, want, rtol=1e-9, atol=1e-9 * np.abs(want).max())


def test_one_path_for_all_is_a_path_of_each() -> None:
    position = path(120, 1)
    dynamics = Dynamics(T1, L, NONE, False, (lag(T2),))
    want = free_run(position.repeat(3, axis=1), dynamics, step_s=1.0)
    np.testing.assert_allclose(free_run(position, dynamics, step_s=1.0), want, rtol=1e-12)


@pytest.mark.parametrize(("top", "bottom", "integrating"), [
    ([1.0], [9.0, 1.8, 1.0], False), ([-4.0, 1.0], [2.0, 1.0], False), ([-4.0, 1.0], [2.0, 1.0], True)])
def test_elements_are_what_runge_kutta_makes_of_them(top: list, bottom: list, integrating: bool) -> None:
    position = path(60, 1)
    m = len(bottom)
    numerator = np.array([0.0] * (m - len(top)) + top)[:, None]
    dynamics = Dynamics(np.array([6.0]), np.array([2.25]), np.zeros(1), integrating,
                        (element_of(numerator, np.array(bottom)[:, None]),))
    got = free_run(position, dynamics, step_s=1.0, substeps=2)[:, 0]
    want = naive.series(position[:, 0], 6.0, 2.25, 0.0, np.array(top), np.array(bottom), integrating, 1.0, 2, fine=40)
    np.testing.assert_allclose(got, want, atol=2e-6 * max(np.abs(want).max(), 1.0))


def test_an_unknown_start_decays_with_the_element() -> None:
    out = np.empty((2 * 50, 3))
    ringing = element_of(np.stack([NONE, NONE, 1.0 + NONE]), np.stack([T2**2, 0.6 * T2, 1.0 + NONE]))
    modes(ringing, out, step_s=1.0)
    time = np.arange(50.0)[:, None]
    w, z = 1.0 / T2, 0.3
    fast = w * np.sqrt(1.0 - z * z)
    # The output's own state from 1, with none in the other: a decaying wave of the element's frequency.
    want = np.exp(-z * w * time) * (np.cos(fast * time) - z * w / fast * np.sin(fast * time))
    np.testing.assert_allclose(out[:50], want, atol=1e-9)


def test_an_element_in_steps_is_the_element_at_once() -> None:
    position = path(80, 1)
    element = element_of(np.array([[-3.0], [1.0]]), np.array([[2.0], [1.0]]))
    step = Stepped(element, 1.0)
    found = [step.advance(u, u) for u in (position[:, 0] - position[0, 0]).tolist()]
    dynamics = Dynamics(np.array([1e-9]), np.zeros(1), np.zeros(1), False, (element,))
    want = free_run(position, dynamics, step_s=1.0)[:, 0]
    np.testing.assert_allclose(found[:-1], want[1:], atol=2e-3 * np.abs(want).max())


def test_no_states_change_nothing() -> None:
    position = path(90)
    same = element_of(np.ones((1, 3)), np.ones((1, 3)))
    want = free_run(position, Dynamics(T1, L, NONE, False), step_s=1.0)
    np.testing.assert_allclose(free_run(position, Dynamics(T1, L, NONE, False, (same,)), step_s=1.0), want, atol=1e-9)
