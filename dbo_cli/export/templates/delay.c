@members
    double wanted[DBO_WINDOW];
    int waiting;
@init
    state->waiting = 1;
@step
    for (int k = 0; k < DBO_WINDOW; k++) /* at rest before the first sample */
        state->wanted[k] = state->waiting || k == DBO_WINDOW - 1 ? x : state->wanted[k + 1];
    state->waiting = 0;
    {
        static const double times[DBO_WINDOW] = {0.0, 1.0, 2.0, 3.0, 4.0, 5.0};
        x = dbo_between(times, state->wanted, 2, $PART);
    }
