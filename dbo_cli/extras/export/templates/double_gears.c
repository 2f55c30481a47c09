/*? lookup */
/*? limits */
    x = dbo_lookup_step(&lookup, &state->gears, x, LIMITS);
/*: limits */
/*? !limits */
    x = dbo_lookup_step(&lookup, &state->gears, x, 0);
/*: limits */
/*: lookup */
/*? !lookup */
/*? limits */
    x = dbo_backlash_step_fixed(&op, &fixed, &state->gears, x, LIMITS, 0);
/*: limits */
/*? !limits */
/*? terms */
    x = dbo_backlash_step(&op, &state->gears, x, decay, 0, 0);
/*: terms */
/*? !terms */
    x = dbo_backlash_step(&op, &state->gears, x, 0, 0, 0);
/*: terms */
/*: limits */
/*: lookup */
