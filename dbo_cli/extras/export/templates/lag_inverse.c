/*? slew */
    const double last = state->lagging ? state->lag.u : BEGUN;
/*: slew */
    const double wanted = x;
    double low = LEAST, high = MOST, v;
    dbo_limits within = {INNER_LEAST, INNER_MOST, 0.0, 0, 0};
    dbo_section_state undone;
/*+ keep */
/*+ once */
    undone.p = state->lagging ? state->lag.u : x;
    undone.q = 0.0;
    undone.u = state->lagging ? state->lag.p : x;
    dbo_dynamics_run(1, &lag_output, &undone, &x, &v, 1, lag_undone, 0);
    state->lag.q = 0.0;
/*? slew */
    if (v < LEAST || v > MOST || (v > last ? v - last : last - v) > CHANGE) { /* again, with the drive that the limits leave */
        double least = towards(last, -CHANGE), most = towards(last, CHANGE);
        least = least < LEAST ? LEAST : least > MOST ? MOST : least;
        most = most > MOST ? MOST : most < LEAST ? LEAST : most;
/*: slew */
/*? !slew */
    if (v < LEAST || v > MOST) { /* again, with the drive that the limits leave */
        double least = LEAST, most = MOST;
/*: slew */
        low = least;
        high = most;
        if (state->lagging) {
            const double p = state->lag.p, u = state->lag.u;
            low = p + PART * (u - p) + RISE * (least - u);
            high = p + PART * (u - p) + RISE * (most - u);
        }
        if (!(low < high)) high = next_above(low);
/*+ bring_back */
        x = low;
/*+ drive_steps */
        within.low = x;
        x = high;
/*+ drive_steps */
        within.high = x;
        if (x < within.low) {
            within.high = within.low;
            within.low = x;
        }
        if (!(within.low < within.high)) within.high = next_above(within.low);
        x = wanted;
/*+ once_again */
        if ((x - low <= high - x ? x - low : high - x) <= 1e-9 * (high - low)) {
            v = x - low <= high - x ? least : most;
        } else { /* only rounding was in the way */
            v = x;
            if (state->lagging) {
                const double p = state->lag.p, u = state->lag.u;
                v = u + ((x - p) - PART * (u - p)) / RISE;
            }
            v = v < least ? least : v > most ? most : v;
        }
        undone.u = x;
        undone.p = v;
    }
    state->lag.p = undone.u;
    state->lag.u = undone.p;
    state->lagging = 1;
    x = v < LEAST ? LEAST : v > MOST ? MOST : v;
