"""How the suite runs: what cases cost, which of them share a process, and what each leaves as it was."""
