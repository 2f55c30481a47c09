    int32_t wanted[$DELAY_WINDOW];
    dboq_checkpoint checkpoints[$CHECKPOINTS];
    dboq_backlash_state gears;
    dboq_place turns[$TURNS];
    dboq_memory memory[$TERMS];
    uint32_t segments[3];
    int filled; /* the window of the delay */
