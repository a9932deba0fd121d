"""`python -m jaxest.cli` is `jaxest`."""

from jaxest.cli import main

main()
