    if (state->begun) $STEP
    else x = dbo_backlash_step(&op, &state->gears, x, at_rest, &limits, 0);
    state->begun = 1;
