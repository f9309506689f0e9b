"""What docs/sweeps.md says is so."""

import re
from pathlib import Path

from jaxlocomanip.sampling import study
from jaxlocomanip.sampling.feasibility import REASONS
from jaxlocomanip.sampling.parameters import PARAMETERS
from jaxlocomanip.sampling.study import find_study, parse_study

TEXT = (Path(__file__).parents[1] / "docs" / "sweeps.md").read_text(encoding="utf-8")


def test_every_parameter_study_and_reason_is_named():
    for name, parameter in PARAMETERS.items():
        assert re.search(rf"^\| `{re.escape(name)}` \| .* \| {re.escape(parameter.meaning)} \|$", TEXT, re.MULTILINE), (
            name
        )
    for name in (*study.names(), *REASONS):
        assert f"| `{name}` |" in TEXT


def test_the_study_file_is_correct():
    (text,) = re.findall(r"^```toml\n(.*?)^```$", TEXT, re.MULTILINE | re.DOTALL)
    mine = parse_study(text)
    assert (mine.count, len(mine.points), len(mine.variants)) == (200, 3, 2)
    assert mine.parameters["team.size"] == find_study("standard").parameters["team.size"]
