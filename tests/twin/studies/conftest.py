"""What tests of studies may ask for."""

from importlib import import_module

import pytest


@pytest.fixture
def no_report(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw nothing: for studies of which only the figures count."""
    monkeypatch.setattr(
        import_module("twin.studies.api"), "write_report", lambda result, progress: None
    )
