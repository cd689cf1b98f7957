"""Parts of every command: values that users give, checks of arguments, Ctrl-C, exit codes."""
