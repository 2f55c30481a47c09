static double next_above(double value) {
    union {
        double value;
        uint64_t bits;
    } u;
    u.value = value;
    u.bits = value == 0.0 ? 1 : value > 0.0 ? u.bits + 1 : u.bits - 1;
    return u.value;
}

