"""What 1.0 promises, seen from outside: the command line and the public library, black box."""
