"""Check of FMUs under adverse masters, in the sandbox."""
