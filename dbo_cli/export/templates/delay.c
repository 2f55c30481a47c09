@members
    $NUMBER wanted[6];
    int waiting;
@init
    state->waiting = 1;
@step
    for (int k = 0; k < 6; k++) /* at rest before the first sample */
        state->wanted[k] = state->waiting || k == 5 ? x : state->wanted[k + 1];
    state->waiting = 0;
    x = $BETWEEN;
