"""Parts of every command: numbers and places that users give, Ctrl-C, exit codes and refusals."""
