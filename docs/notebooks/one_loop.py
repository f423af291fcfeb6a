# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # One loop, from a DataFrame to the cause
#
# A flow loop cycles. A historian gives one sample a second: setpoint, flow, and the output of the controller. This
# notebook asks whether the valve sticks, how much, and what else moves the flow.
#
# ## The record
#
# The loop here is simulated in plain numpy, so that the answer is known. Its valve rests until the command has moved
# 4.0 % and then jumps; the stickband plus deadband S is 5 %, the slip jump J is 3 %. A pump upstream adds a slow wave
# to the flow. Nothing below is told about either.

# %%
import numpy as np
import pandas as pd

import stictionid as st

S, J = 5.0, 3.0
rng = np.random.default_rng(7)
n = 1500
sp, op, pv = np.full(n, 52.0), np.full(n, 50.0), np.full(n, 50.0)
stem, held, way, flow, total = 50.0, True, 0.0, 0.0, 0.0
travel = np.full(n, 50.0)
for k in range(1, n):
    # First order with 2 s of dead time, gain 1.2 and a time constant of 9 s; the pump's wave has a period of 210 s.
    flow += (1.2 * (travel[max(k - 3, 0)] - 50.0) - flow) * (1.0 - np.exp(-1.0 / 9.0))
    pump = 1.5 * np.sin(2.0 * np.pi * k / 210.0)
    pv[k] = 50.0 + flow + pump + 0.05 * rng.standard_normal()
    error = sp[k] - pv[k]
    total += 0.9 * error / 10.0
    op[k] = 50.0 + 0.9 * error + total
    # The valve: held until the command is (S + J) / 2 away, then (S - J) / 2 behind it until the command turns.
    move = op[k] - op[k - 1]
    held = held or move * way < 0.0
    way = move or way
    if not held or abs(op[k] - stem) > 0.5 * (S + J):
        stem, held = op[k] - np.sign(op[k] - stem) * 0.5 * (S - J), False
    travel[k] = stem

frame = pd.DataFrame({"FIC101.SP": sp, "FIC101.PV": pv, "FIC101.OP": op},
                     index=pd.date_range("2026-03-04 08:00", periods=n, freq="1s", name="Time"))
frame.head(3)

# %% [markdown]
# ## The loop
#
# A DataFrame becomes a `Loop`. Columns may be named; here their suffixes say enough, and the index is the time. The
# same checks run as on a file: gaps, frozen values, units, manual stretches.

# %%
loop = st.Loop.from_dataframe(frame, units={"process_value": "m³/h"})
loop

# %% [markdown]
# ## Does the valve stick?
#
# `identify` fits valve and process together and lets the model run freely, with the output as its only input. The
# process value is never fed back.

# %%
study = st.identify(loop)
study

# %% [markdown]
# ## What the model misses
#
# `diagnose` refits the model with each effect of the catalogue. It names one only where held-out blocks are predicted
# better, and where no model of the noise does as well. `apply=True` adds it and asks again.

# %%
found = st.diagnose(study, loop, apply=True)
found.summary()[["value", "low", "high", "unit"]]

# %%
found

# %% [markdown]
# Every candidate stays in a table, the best first, with the reason why it was not taken:

# %%
found.candidates[["effect", "accepted", "gain_beyond_noise", "rejected_because"]].head(4)

# %% [markdown]
# ## Pictures
#
# Each picture is a matplotlib Axes. `ladder` sets the free-run error of each step beside the noise; no model can be
# better than that.

# %%
found.plot.fit(loop).figure

# %%
found.plot.ladder().figure

# %% [markdown]
# `curves` has one row for each row of the DataFrame, so that the model's curves join your own columns:

# %%
curves = found.curves(loop)
frame.join(curves[["model", "residual", "valve_position"]]).iloc[600:603]

# %% [markdown]
# The truth is known here. The valve is right, and so is the wave:

# %%
e = found.estimate
truth = pd.DataFrame({"truth": [S, J, 1.2, 9.0], "found": [e.S, e.J, e.gain, e.time_constants_s[0]]},
                     index=["S", "J", "gain", "time constant"])
truth.round(3)

# %% [markdown]
# ## To keep
#
# The study is one JSON file, the page one HTML file without anything to fetch.

# %%
found.save("study.json")
st.report(found, "loop.html")
