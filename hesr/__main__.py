"""`python -m hesr`."""

from hesr.cli import main

main()
