"""The program as a shell runs it."""

from typer.testing import CliRunner, Result

from twin.cli import app


def invoke(*arguments: object, code: int | None = None) -> Result:
    """Run a command, which must end with a code where that is given."""
    result = CliRunner().invoke(app, [str(a) for a in arguments])
    assert code in (None, result.exit_code), result.output
    return result
