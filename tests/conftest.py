"""What several test files need: the reference data beside the project."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import Phase, settings

settings.register_profile(  # a mutant need not be told its simplest counter-example
    "mutation", derandomize=True, database=None, phases=[Phase.explicit, Phase.generate]
)


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder `../shared` with real clouds and reference results, or a skip that says so."""
    folder = Path(__file__).resolve().parents[2] / "shared"
    if not folder.is_dir():
        pytest.skip("no folder ../shared with the reference data")
    return folder
