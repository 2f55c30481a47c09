"""The shell: options, commands and exit codes."""
