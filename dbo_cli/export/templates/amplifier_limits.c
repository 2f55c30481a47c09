    const double before = state->begun ? state->amplifier : 0.0;
    const double share = state->begun ? $SHARE : 1.0;
    const double target = x;
    double low = $LEAST, high = $MOST, low_end;
    dbo_limits limits = {0.0, 0.0, 0.0, 0, 0};
$SLEW
    x = before + share * (low - before);
$LOW_END
    low_end = x;
    x = before + share * (high - before);
$HIGH_END
    limits.low = low_end < x ? low_end : x;
    limits.high = low_end < x ? x : low_end;
    x = target;
