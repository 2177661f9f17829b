"""What tests of studies may ask for."""

import pytest


@pytest.fixture
def no_report(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw nothing: for studies of which only the figures count."""
    monkeypatch.setattr("twin.study.api.write_report", lambda result, progress: None)
