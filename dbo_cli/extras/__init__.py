"""What the program can do besides: each folder is one thing that a reader, or an installation, may leave out.

The core never imports a module from here. Core and extras meet in the table of
``dbo_cli/extensions.py``.
"""
