    if ((int64_t)x - state->output < -$MOST_CHANGE) x = (int32_t)(state->output - $MOST_CHANGE);
    if ((int64_t)x - state->output > $MOST_CHANGE) x = (int32_t)(state->output + $MOST_CHANGE);
