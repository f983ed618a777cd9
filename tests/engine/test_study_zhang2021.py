"""The study of zhang2021: its cells, and the table that they make."""

from __future__ import annotations

import json

import pytest

from engine.errors import ScenarioError
from engine.studies.base import Settings, as_plain, study
from engine.studies.zhang2021 import CLASSES, SEEN, SHARES, Zhang2021, solve_cell


def test_it_is_a_study_by_name() -> None:
    found = study("zhang2021")
    assert found.paper.startswith("Zhang et al. 2021")
    assert found.maps[1] >= 20
    with pytest.raises(ScenarioError, match="did you mean 'zhang2021'"):
        study("zhang2020")


def test_every_class_and_both_experiments_have_cells() -> None:
    cells = Zhang2021().cells(Settings(maps=3))
    assert len(cells) == 3 * (len(CLASSES) + 1)
    assert json.loads(json.dumps(cells)) == cells


def test_the_table_is_made_of_its_cells() -> None:
    """One map of each: the cheapest way is not dearer, the shortest not longer, and repair equals planning anew."""
    kept = [
        c
        for c in Zhang2021(size_m=20.0).cells(Settings(maps=1))
        if (c["experiment"], c["class"]) in ((1, "bumps"), (2, "bumps"))
    ]
    results = [solve_cell(cell) for cell in kept]
    ways, changed = results
    assert ways["energy_j"]["energy"] <= ways["energy_j"]["distance"]
    assert ways["length_m"]["energy"] >= ways["length_m"]["distance"] >= 13.8
    assert [bound for bound, _, _ in ways["curve"]] == [2.5, 2.0, 1.5, 1.0]
    assert all(1 <= over <= bound for bound, over, _ in ways["curve"])
    assert ways["curve"][-1][1] == 1
    assert set(changed["expanded"]) <= {SEEN, *(f"{100 * share:g} %" for share in SHARES)}
    assert min(changed["expanded"].values()) < 10

    class Same(Zhang2021):
        __slots__ = ()

        def cells(self, settings: Settings) -> list:
            return kept

    result = Same(size_m=20.0).run(Settings(maps=1), lambda done, of, what: True)
    assert result.breaches == 0 < result.plans
    assert {r.quantity for r in result.rows if r.experiment == 1} >= {"energy saved over the shortest way"}
    assert {f.name for f in result.figures} == {"classes", "anytime", "repair", "figure-8"}
    json.dumps(as_plain(result))
