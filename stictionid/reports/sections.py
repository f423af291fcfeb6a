"""Details of the facts: laws, next steps, range, data, parameters, method and commands."""

from __future__ import annotations

import json
import shlex
from itertools import zip_longest

from ..record.as_json.shape import folded
from ..record.oscillation import holds_start
from ..record.study import Estimate, Step, Study
from . import effect_words, story, tree_text, wording
from .document import PageTable, Section

# Samples per period below which the slips cannot be resolved. Unit: samples; docs/details.md, section 6.
FEWEST_SAMPLES_PER_PERIOD = 10
# Cycles that a new record should hold. Three is the least that is judged, ten make intervals useful. Unit: cycles.
WANTED_CYCLES = 10
# A bump in MAN that a healthy valve follows. Unit: % of OP span; docs/details.md, section 13.
BUMP_PERCENT = 0.5
# Cycles shown in the table; the rest is left to the JSON. Unit: rows; half a printed page.
_CYCLES_SHOWN = 12
# Evidence of the verdict in words: a key alone would pass for the study's own error, or needs the JSON's glossary.
_QUICK = {"rmse_without_friction": "quick-fit error without friction", "rmse_with_friction": "quick-fit error with "
          "friction", "error_drop": "fall of the quick-fit error", "one_step_without": "quick one-step error without "
          "friction", "one_step_with": "quick one-step error with friction", "one_step_drop": "fall of the quick "
          "one-step error", "likelihood_ratio": "likelihood ratio, 2 log L", "blocks_won": "blocks on which friction "
          "predicts better", "blocks": "blocks compared", "held_out_gain": "fall of the one-step error on held-out "
          "blocks", "held_out_won": "held-out blocks on which friction predicts better", "effects": "effects in both",
          "S_excluded_above": "S above this is excluded"}
_ROLE_NAMES = {"setpoint": "setpoint SP", "output": "controller output OP", "process_value": "process value PV",
               "position": "valve position", "time": "time"}


def mapped_step(study: Study) -> int | None:
    """Index of the step whose model the cost map shows, the last one of identify; None where it is not known.

    For studies without that index it is the step whose S and J have the least cost in the map.
    """
    m = study.cost_map
    if m is None or not study.steps:
        return None
    if m.step is not None:
        return min(max(m.step, 0), len(study.steps) - 1)
    if len(study.steps) == 1:
        return 0
    depths = []
    for i, step in enumerate(study.steps):
        at = {p.name: p.value for p in step.parameters if p.effect is None}
        if "S" in at and "J" in at and m.S and m.J:
            row = min(range(len(m.S)), key=lambda k: abs(m.S[k] - at["S"]))
            column = min(range(len(m.J)), key=lambda k: abs(m.J[k] - at["J"]))
            value = m.rmse[row][column] if row < len(m.rmse) and column < len(m.rmse[row]) else None
            depths += [(value, i)] if value is not None else []
    return min(depths)[1] if depths else None


def added_later(study: Study) -> tuple[Step, ...]:
    """Steps that diagnose or add put behind those of identify."""
    last = mapped_step(study)
    return () if last is None else tuple(s for s in study.steps[last + 1:] if s.added)


def tree(study: Study) -> Section | None:
    """Models that the search tried, as a picture and as lines; None where the study has no tree."""
    if not study.tree:
        return None
    some = "1 model was" if len(study.tree) == 1 else f"{wording.count(len(study.tree))} models were"
    after = tree_text.after_tree(study)
    return Section("tree", "Models tried", (f"{some} tried" + (f"; {after}." if after else "."),), (), (), ("tree",),
                   lines=tree_text.tree_lines(study), lines_title="The search as text, best first")


def equivalents(study: Study) -> Section | None:
    """Models that explain the record as well as the answer does; None where there are none."""
    said = tree_text.equivalents(study)
    if not said:
        return None
    return Section("equivalents", "Other models that explain the record alike",
                   ("The intervals of S and J cover the answer and these models.",), tuple(map(wording.sentence, said)))


def laws(study: Study) -> Section | None:
    """Every stiction law fitted to the same record; None without `--law all`."""
    if not study.laws:
        return None
    rows = tuple((wording.name(w.law), wording.number(w.S), wording.number(w.J), wording.number(w.rmse),
                  wording.number(w.rmse_holdout)) for w in study.laws)
    table = PageTable("Stiction laws on the same record", ("law", "S", "J", "error", "held out"), rows, (1, 2, 3, 4))
    return Section("laws", "Other stiction laws", ("The spread of S over the laws is a doubt no interval holds.",),
                   (), (table,))


def next_steps(study: Study) -> Section:
    """Next actions and measurements, by the verdict and by what this record lacks."""
    period = study.range.period_median_s
    wait = f"at least five periods, {wording.duration(5 * period)}" if period else "several minutes"
    manual = (f"Put the loop in MAN for {wait}: if the oscillation stops, it comes from valve or tuning; if it goes "
              "on, it comes from outside this loop.")
    bump = f"Bump OP in MAN by {BUMP_PERCENT:g} % steps in one direction, then in the other, until PV moves"
    e = study.estimate
    if e is None:
        return Section("next", "What to do next", bullets=tuple(_for_abstained(study)))
    if study.verdict.stiction == "stiction":
        bullets = [manual, f"{bump}: after a reversal it should take about {wording.number(e.S)} "
                           f"{wording.name(e.unit)}" + (f", and the first move should be about {wording.number(e.J)} "
                                                        f"{wording.name(e.unit)} large." if e.J_known else ".")]
    elif study.verdict.stiction == "undecided":
        settles = study.planned_test is not None and study.planned_test.moves
        bullets = [manual, *([] if settles else [f"{bump}: a valve that follows each step does not stick."]),
                   f"Record {WANTED_CYCLES} whole cycles or more, with two or three setpoint moves: they separate S "
                   "from the process gain."]
    else:
        bullets = ["Look elsewhere for the oscillation: tuning, an upstream loop, or a disturbance. " + manual]
    if study.steps:
        bullets += [f"{effect_words.sentence(study, name)} {effect_words.action(study, name)}".strip()
                    for name in effect_words.of_model(study)]
        bullets += _for_the_model(study)
    if asked := story.asked_position(study):
        bullets.append(asked)
    elif "position" not in study.data.columns:
        bullets.append("Log the positioner's travel feedback beside OP: S and J can then be read from it directly.")
    if "setpoint" not in study.data.columns:
        bullets.append("Export the setpoint too: without it nobody can tell what a perfect valve would change.")
    if any(word in f.code for f in study.data.findings for word in ("compress", "exception", "average")):
        bullets.append("Export raw values: compression or averaging removes the small reversals that are stiction.")
    return Section("next", "What to do next", bullets=tuple(bullets))


def _for_the_model(study: Study) -> list[str]:
    """The command that explains more of the error, where something is left to explain."""
    present = {s.added for s in study.steps} | {e for s in study.steps for e in s.effects}
    waiting = [m for m in study.missing if m not in present]
    if waiting:
        return [f"Add the effect that the record asks for: stictionid add {wording.name(waiting[0])} STUDY."]
    if study.adequate is False and not study.candidates:
        return ["Ask which effect is missing, because the model does not reach the noise: stictionid diagnose STUDY."]
    return []


def _for_abstained(study: Study) -> list[str]:
    """Requirements that this record does not meet, as advice for the next one."""
    r, step = study.range, study.data.step_s
    bullets = []
    if r.period_s is None and r.reversals < 2:
        bullets.append("Export a stretch in which the loop was in AUTO and the controller output moved both ways; a "
                       "constant output says nothing about the valve.")
    if r.period_median_s and r.period_median_s < FEWEST_SAMPLES_PER_PERIOD * step:
        bullets.append(f"Export faster: the period is {wording.duration(r.period_median_s)} and samples come every "
                       f"{wording.duration(step)}; {FEWEST_SAMPLES_PER_PERIOD} samples per period are needed, so "
                       f"{wording.with_unit(r.period_median_s / FEWEST_SAMPLES_PER_PERIOD, 's')} or less.")
    elif r.period_median_s:
        bullets.append(f"Export {WANTED_CYCLES} whole cycles or more: "
                       f"{wording.duration(WANTED_CYCLES * r.period_median_s)} at the present period.")
    else:
        bullets.append(f"Export a stretch that oscillates, {WANTED_CYCLES} whole cycles or more, or one with setpoint "
                       "moves that make the valve reverse at least four times.")
    bullets.append(f"Or test the valve directly: bump OP in MAN by {BUMP_PERCENT:g} % steps in one direction, then in "
                   "the other, and log PV (and the positioner's travel) every second.")
    return bullets


def oscillation(study: Study) -> Section:
    """Period, largest swing and the cycles behind them."""
    r = study.range
    start = holds_start(r.cycles)
    rows = (("oscillating", "yes" if r.oscillating else "no"),
            ("longest cycle T (Shang et al., Eq. 20)", wording.duration(r.period_s)),
            ("median cycle", wording.duration(r.period_median_s)),
            ("largest swing of OP, S_max (Shang et al., Eq. 21)", wording.with_unit(r.s_max, r.unit)),
            ("whole cycles that count", wording.count(len(r.cycles) - start)),
            ("reversals of OP", wording.count(r.reversals)), ("deviations taken from", wording.name(r.reference)))
    tables = [PageTable("Oscillation", ("quantity", "value"), rows, (1,))]
    if r.cycles:
        shown = r.cycles[:_CYCLES_SHOWN]
        rest = "" if len(shown) == len(r.cycles) else f", first {len(shown)} of {len(r.cycles)}"
        marks = (" (start, does not count)" * start, *[""] * len(shown))
        tables.append(PageTable(f"Cycles{rest}", ("starts at", "length", "swing of OP"), tuple(
            (f"{wording.number(c.start_s, 4)} s{mark}", f"{wording.number(c.period_s, 4)} s",
             wording.with_unit(c.u_swing, r.unit)) for c, mark in zip(shown, marks, strict=False)), (0, 1, 2)))
    return Section("range", "Oscillation and search range", (wording.sentence(r.reason),), (), tuple(tables))


def data(study: Study) -> Section:
    """Source of the data, the interpretation of its columns, and findings of the reading."""
    d = study.data
    rows = [("file", wording.name(d.file or wording.NOTHING)),
            ("SHA-256", wording.clean(d.sha256 or wording.NOTHING, 80)),
            ("rows in the file", wording.count(d.rows)), ("samples used", wording.count(d.rows_used)),
            ("sampling time", wording.duration(d.step_s)), ("first sample", wording.name(d.start or wording.NOTHING)),
            ("last sample", wording.name(d.end or wording.NOTHING))]
    rows += [(f"option {wording.name(key)}", wording.clean(json.dumps(value, ensure_ascii=False), 80))
             for key, value in sorted(d.options.items())]
    columns = tuple((_ROLE_NAMES.get(role, wording.name(role)), wording.name(tag),
                     wording.name(d.units.get(role) or wording.NOTHING)) for role, tag in d.columns.items())
    tables = [PageTable("The record", ("what", "value"), tuple(rows))]
    if columns:
        tables.append(PageTable("Columns", ("role", "column in the file", "unit"), columns))
    if d.findings:
        tables.append(PageTable("Noticed while reading", ("severity", "what", "code"), tuple(
            (wording.name(f.severity), wording.sentence(f.statement), wording.name(f.code)) for f in d.findings)))
    return Section("data", "How the data were read", (), (), tuple(tables))


def parameters(study: Study) -> Section | None:
    """Every fitted parameter of the last step, and the process in words."""
    if not study.steps:
        return None
    rows, open_jump = [], study.estimate is not None and not study.estimate.J_known
    for p in study.steps[-1].parameters:
        notes = [n for n, on in (("at its limit: read as a bound", p.at_bound),
                                 ("not identifiable from this record", not p.identifiable),
                                 ("the record leaves more than half of it open",
                                  open_jump and p.name == "J" and not p.effect)) if on]
        rows.append((wording.name(p.effect or "base"), wording.name(p.name), *wording.apart(p.value, p.interval),
                     wording.name(p.unit or wording.NOTHING),
                     "; ".join([wording.clean(p.meaning, 120)] * bool(p.meaning) + notes)))
    unit_y = study.data.units.get("process_value") or "units of PV"
    text = [_process_sentence(study.estimate, unit_y)] if study.estimate is not None else []
    table = PageTable("Parameters of the last model", ("part", "name", "value", "interval", "unit", "meaning"),
                  tuple(rows), (2, 3))
    return Section("parameters", "Parameters", tuple(text), (), (table,))


def _process_sentence(e: Estimate, unit_y: str) -> str:
    known = zip_longest(e.time_constants_s, e.time_constants_intervals)
    lags = wording.listed([_with_ends(t, span, "s") for t, span in known]) or "none"
    lags = f"time constant{'s' if len(e.time_constants_s) > 1 else ''} {lags}"
    kind = "integrator" if e.integrating else "self-regulating process"
    unit = f"{unit_y} per {e.unit}{' and s' if e.integrating else ''}"
    return (f"Valve law {wording.name(e.law)}; {kind} with gain "
            f"{_with_ends(e.gain, e.gain_interval, unit)}, {lags}, dead time "
            f"{_with_ends(e.dead_time_s, e.dead_time_interval, 's')}. At the start the stem was loaded with "
            f"{wording.number(100 * e.initial_residual_force, 2)} % of its static friction.")


def _with_ends(value: float, span: tuple[float, float] | None, unit: str) -> str:
    return wording.with_unit(value, unit) if span is None else wording.estimate(value, span, unit)


def method(study: Study) -> Section:
    """Versions, seed, evidence behind the verdict, and the commands that reproduce this study."""
    c, d = study.created_by, study.data
    rows = [("stictionid", wording.name(c.version)), ("seed", str(c.seed)), ("Python", wording.name(c.python)),
            ("NumPy", wording.name(c.numpy)), ("Numba", wording.name(c.numba)), ("study schema", study.schema)]
    tables = [PageTable("Made by", ("what", "value"), tuple(rows))]
    measured = folded(study.verdict.evidence)
    if "S_excluded_above" in measured:
        # (the digits of the verdict's sentence)
        measured["S_excluded_above"] = wording.number(study.verdict.evidence.S_stated_above, 2)
    if measured:
        tables.append(PageTable("Evidence behind the verdict, of the quick fits", ("quantity", "value"), tuple(
            (_QUICK.get(k) or wording.name(k), _evidence(v)) for k, v in measured.items()
            if k != "share_of_pv_variance")))
    file = wording.clean(d.file, 400) if d.file else "FILE"
    commands = []
    if d.sha256:
        commands.append(f"sha256sum {shlex.quote(file)}   # {wording.clean(d.sha256, 80)}")
    commands.append(wording.clean(study.command) or
                    f"stictionid identify {shlex.quote(file)} --seed {c.seed} -o study.json")
    name = shlex.quote(wording.clean(_option(study.command, "-o", "--output") or "study.json", 400))
    commands += [f"stictionid add {shlex.quote(wording.clean(s.added))} {name}" for s in added_later(study)]
    return Section("method", "Method and how to reproduce it", (_method_sentence(study),), (), tuple(tables), (),
                   tuple(commands))


def _method_sentence(study: Study) -> str:
    if not study.steps:
        return "No model was fitted, because the record can't tell; the verdict says why."
    asked = _option(study.command, "--method") or "auto"
    if asked != "auto":
        return (f"Method {wording.name(asked)}; stictionid identify --help names them. The verdict compares the best "
                "model with friction and the best one without it on the same samples.")
    return ("S, J, the dead time and the lags are searched by a swarm from several starts, gain and offset by least "
            "squares within each trial; searches that end alike are counted as agreeing. The verdict compares the "
            "best model with friction and the best one without it on the same samples.")


def _option(command: str, *names: str) -> str | None:
    """The value that a recorded command gave one of its options."""
    try:
        words = shlex.split(command)
    except ValueError:
        return None
    for i, word in enumerate(words):
        if word in names and i + 1 < len(words):
            return words[i + 1]
        for name in names:
            if name.startswith("--") and word.startswith(name + "="):
                return word.partition("=")[2]
    return None


def _evidence(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        return wording.number(value)
    if isinstance(value, (list, tuple)) and all(isinstance(name, str) for name in value):
        return wording.clean(", ".join(value) or "none", 80)
    return wording.clean(value if isinstance(value, str) else json.dumps(value, ensure_ascii=False, default=str), 80)
