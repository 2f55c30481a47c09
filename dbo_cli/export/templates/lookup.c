@members
    dbo_lookup_state gears;
@init
    state->gears.state = ${EMPTY}U;
    state->gears.last = $LAST;
@reset
    dbo_lookup_settle(&lookup, &state->gears, ${INSIDE}U, ${EMPTY}U, x);
@step
    x = dbo_lookup_step(&lookup, &state->gears, x, &limits);
