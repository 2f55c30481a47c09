"""File shapes as instruments and programs write them, by hand: what each holds and how it must read."""
