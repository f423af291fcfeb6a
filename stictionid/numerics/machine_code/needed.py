"""Kernels that `identify` asks for on common loops; written by benchmarks/kernels.py.

Those of a plain record come first, from the last one used to the first: the command itself begins with the first. Those
of further records follow in the order of use.

A line is a kernel, then a word an argument: the letter of its dtype; of an array also dimensions, layout, r: read-only.
"""

from __future__ import annotations

# Number of the kernels below that a plain record asks for.
PLAIN = 21
NEEDED: tuple[str, ...] = (
    "stictionid.verdict.severity._closed d1C d1C l d d1C l d ? d d d d d1C d1C",
    "stictionid.numerics.varpro._whiten_stack d2C l d1C",
    "stictionid.process.linear._run d2C l d2C l1C l1C l1C d2C",
    "stictionid.numerics.noise.survey.levinson_lanes d2C d3C d2C",
    "stictionid.numerics.varpro._whiten d2C d1C d2C",
    "stictionid.numerics.gauss_newton._moves d3C d2C d1C d3C",
    "stictionid.numerics.gauss_newton._normals d2C d2C d3C d2C",
    "stictionid.numerics.varpro._residuals d2C l1C d2C d3C d1C d1C d2C d2C",
    "stictionid.numerics.population._principal l1C d3C d3C d2C",
    "stictionid.numerics.population._adapt l1C ?1C d3C l2C d3C d2C d1C d1C l d1C d2C d1C d3C d2C d2C",
    "stictionid.numerics.population._draw l1C d3C d2C d1C d3C d2C d1C d1C d3C d3C",
    "stictionid.numerics.cross_products.products_kernel d2C l1C d2C l1C l1C d3C d3C",
    "stictionid.process.linear._decay d1C d d2C",
    "stictionid.process.linear._run_plain d2C d2C l1C d2C",
    "stictionid.process.linear._coefficients d1C d1C d1C d l ? ? d2C l1C l1C",
    "stictionid.numerics.varpro._solve d3C d3C l d d1C d2C",
    "stictionid.numerics.cross_products._unshifted d2C d d1C d2C l l l1C d3C d4C d4C",
    "stictionid.numerics.cross_products._lagged d2C d d1C l l l1C d3C",
    "stictionid.laws.chen._run d1C d2C d1C d2C d2C",
    "stictionid.laws.chen._rest d d2C d1C d2C",
    "stictionid.laws.contract._fill d1C d1C d2C",
    "stictionid.process.intersample._means d1C d1C d1C d1C d1C d1C d2C",
    "stictionid.process.linear._run_path d1C l d2C l1C l1C l d2C",
    "stictionid.process.linear._run_parts d2C l d2C l1C l1C d2C",
    "stictionid.numerics.filter_bank._filter_backwards d1C l1C d1C d4C",
    "stictionid.numerics.filter_bank._sums d2C l d1C b2C ?1C d1C d3C",
    "stictionid.numerics.filter_bank._normals d3C d3C d3C d2C d1C d4C d4C",
    "stictionid.model.replay._replay d1C d2C d1C d1C ? d1C l1C l1C l d2C d3C d1C l1C l1C",
    "stictionid.numerics.noise.normal._log_between d1C d1C d1C",
    "stictionid.process.state_space._held d3C d2C d1C d3C d2C",
    "stictionid.paths.beam.beam d1C d1C d1C d ? d d1C l l d3C d2C d1C d d d1C ?1C ?1C d1C d d d1C d d1C l l1C l1C l1C",
    "stictionid.numerics.varpro._whiten_softly d2C l l d d",
    "stictionid.numerics.noise.survey._survey d1C ?1C l1C d1C d1C d2C d2C d1C",
    "stictionid.numerics.noise.survey._lagged d2C ?1C l1C d2C d1C",
    "stictionid.numerics.noise.exact.start_of d1C d ? d1C d2C d1C",
    "stictionid.numerics.noise.exact._exact d1C ?1C l1C d1C d d2C d1C ? d1C d1C",
    "stictionid.numerics.noise.landing._gains d3C d2C d1C d l l d1C ?1C d2C d1C d1C ?1C d1C d2C",
    "stictionid.numerics.noise.landing._means d1C d1C d1C",
    "stictionid.numerics.noise.landing._apply d2C l d3C d2C d1C d l l d1C ?1C d2C d1C d2C",
)
