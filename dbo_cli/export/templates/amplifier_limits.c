@members
    double amplifier;
    int begun;
@init
    state->amplifier = 0.0;
    state->begun = 0;
@reset
    state->amplifier = x;
    state->begun = 1;
@step
    const double before = state->begun ? state->amplifier : 0.0;
    const double share = state->begun ? $SHARE : 1.0;
    const double target = x;
    double low = $LEAST, high = $MOST, low_end;
    dbo_limits limits = {0.0, 0.0, 0.0, 0, 0};
    if (low < state->output - $STEP) low = state->output - $STEP;
    if (high > state->output + $STEP) high = state->output + $STEP;
    x = before + share * (low - before);
$LOW_END
    low_end = x;
    x = before + share * (high - before);
$HIGH_END
    limits.low = low_end < x ? low_end : x;
    limits.high = low_end < x ? x : low_end;
    x = target;
