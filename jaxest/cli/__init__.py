"""The command line: `jaxest demo | inspect | estimate | compare | bench | doctor`.

One file a command; each loads what it needs when it runs, so that `jaxest --help` is quick. `main` is the entry point.
Commands only read arguments, call the library and print: whatever they compute can be computed from Python as well.
"""


def main() -> None:
    """Run the command that the process was started with."""
    from jaxest.cli.app import app

    app()


__all__ = ["main"]
