@members
    dboq_checkpoint checkpoints[$CHECKPOINTS];
    dboq_backlash_state gears;
    dboq_place turns[$GEARS];
    dboq_memory memory[$TERMS];
    uint32_t segments[3];
