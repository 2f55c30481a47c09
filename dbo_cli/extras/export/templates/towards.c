/* last + step, rounded towards `last`, as in the kernel: a slew limit is kept to the last bit. */
static double towards(double last, double step) {
    const double sum = last + step, part = sum - last;
    const double lost = (last - (sum - part)) + (step - part);
    const double digit = (sum < 0.0 ? -sum : sum) * 2.220446049250313e-16;
    return step > 0.0 ? (lost < 0.0 ? sum - digit : sum) : (lost > 0.0 ? sum + digit : sum);
}

