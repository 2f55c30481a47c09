#define MAY_DIFFER 0U /* samples */

static unsigned difference(double got, double expected) {
    union {
        double value;
        uint64_t bits;
    } a, b;
    a.value = got;
    b.value = expected;
    return a.bits != b.bits;
}
