"""Command-line toolkit: argument parsing, value types, streams, tables and exit codes."""
