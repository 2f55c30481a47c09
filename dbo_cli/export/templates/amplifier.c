@step
    state->amplifier = x;
    x = before + (x - before) / share;
    x = x < low ? low : x > high ? high : x;
    state->begun = 1;
