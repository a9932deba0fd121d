import pytest
from typer.testing import CliRunner

from jaxest.cli.app import app


@pytest.fixture
def invoke(tmp_path, monkeypatch):
    """Run a command in an empty folder, as typed; a traceback of a bug is raised."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("JAXEST_DEBUG", raising=False)

    def call(*words):
        result = CliRunner().invoke(app, [str(word) for word in words])
        if result.exception is not None and not isinstance(result.exception, SystemExit):
            raise result.exception
        return result

    return call


@pytest.fixture
def refused(invoke):
    """Run a command that must end in one message on standard error, status 2, no traceback; return the message."""

    def call(*words):
        result = invoke(*words)
        assert result.exit_code == 2, result.output
        assert result.stdout == ""
        assert result.stderr.startswith("error: ")
        assert result.stderr.count("error: ") == 1
        assert "Traceback" not in result.stderr
        return result.stderr

    return call
