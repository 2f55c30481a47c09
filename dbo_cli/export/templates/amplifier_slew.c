    if (low < state->output - $STEP) low = state->output - $STEP;
    if (high > state->output + $STEP) high = state->output + $STEP;
