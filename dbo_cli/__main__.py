"""Let ``python -m dbo_cli`` do what ``dbo`` does."""

from __future__ import annotations

from dbo_cli.cli.app import run

if __name__ == "__main__":
    run()
