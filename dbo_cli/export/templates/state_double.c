    double wanted[$DELAY_WINDOW];
    dbo_inverse_state sections[$SECTIONS];
    double windows[$WINDOWS];
    $GEARS_STATE gears;
    dbo_place turns[$TURNS];
    dbo_checkpoint checkpoints[$CHECKPOINTS];
    double memory[$TERMS];
    size_t segments[$CURVES];
    double amplifier; /* its output */
    int filled, begun; /* the windows ahead; the memory, and the amplifier */
