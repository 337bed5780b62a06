"""A wake that is developed once."""

from pathlib import Path

import pytest

from tests.programs.real_wake import develop


@pytest.fixture(scope="session")
def real_wake(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the developed wake of ``real_wake.gait_settings``."""
    folder = tmp_path_factory.mktemp("wakes")
    develop(folder)
    return folder
