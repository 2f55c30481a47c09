"""What leaves for an amplifier: a drive is made of pieces, played through one state, past one gate."""
