"""`python -m companion` is the command `companion`."""

from companion.cli.start import main

main()
