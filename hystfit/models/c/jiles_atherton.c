/* Jiles-Atherton, driven by the field or by the flux density, with or without dynamic fields. State: effective field He = H + alpha M, and irreversible magnetization over Ms. */
static double @f@_langevin(double x)
{
    const double square = x * x;
    if (fabs(x) < 1e-2)
        return x * (1.0 / 3 - square * (1.0 / 45 - square * (2.0 / 945 - square / 4725)));
    return 1 / tanh(x) - 1 / x;
}

static double @f@_curve(double x)
{
    return @M@_TANH ? tanh(x) : @f@_langevin(x);
}

static double @f@_anhysteretic(double field)
{
    const double x = field / @M@_A;
    return @M@_DOUBLE ? @M@_P * @f@_curve(x) + (1 - @M@_P) * @f@_curve(x / @M@_R) : @f@_curve(x);
}

static double @f@_pinning(double m)
{
    return @M@_K * exp(-@M@_Q * m * m);
}

/* Pinning half way to an effective field, by a rough step there. */
static double @f@_pinning_between(const double *s, double sign, double field, double g0, double g1)
{
    const double m = @M@_C * g0 + (1 - @M@_C) * s[1], z = fabs(field - s[0]) / @f@_pinning(m);
    const double follows = sign * fmax(sign * (0.5 * (g0 + g1) - s[1]), 0) * z / (1 + z);
    return @f@_pinning(0.5 * (m + @M@_C * g1 + (1 - @M@_C) * (s[1] + follows)));
}

/* Irreversible part at an effective field, with the anhysteretic curve straight on the way there. */
static double @f@_irreversible(const double *s, double sign, double field)
{
    const double g0 = @f@_anhysteretic(s[0]), g1 = @f@_anhysteretic(field), ahead = s[1] - g0;
    double resting = 0, begin = g0, z, mean;
    if (sign * ahead > 0) {
        resting = g1 == g0 ? 1 : fmin(fmax(ahead / (g1 - g0), 0), 1);
        begin = s[1];
    }
    if (resting >= 1 || field == s[0])
        return s[1];
    z = (1 - resting) * fabs(field - s[0]) / (@M@_Q == 0 ? @M@_K : @f@_pinning_between(s, sign, field, g0, g1));
    mean = z > 0 ? -expm1(-z) / z : 1;
    return g1 - (g1 - begin) * mean - (begin - s[1]) * exp(-z);
}

static double @f@_total(const double *s, double sign, double field)
{
    return @M@_C * @f@_anhysteretic(field) + (1 - @M@_C) * @f@_irreversible(s, sign, field);
}

/* Output without its offset and its part of the input. */
static double @f@_flux(double field, double total)
{
    return @M@_OF_FIELD * field + @M@_OF_TOTAL * total;
}

/* Field of eddy currents and of excess loss at a rate of the output. */
static double @f@_dynamic(double rate)
{
    return @M@_EDDY * rate + @M@_EXCESS * rate / sqrt(hypot(rate, @M@_E));
}

/* The input at an effective field, less u: rising. The flux was `before` a time dt ago; dt is 0 where the rate has no effect. */
static double @f@_miss(const double *s, double sign, double field, double u, double before, double dt)
{
    const double total = @f@_total(s, sign, field), miss = @M@_RISE * field + @M@_LIFT * total - u;
    return dt > 0 ? miss + @f@_dynamic((@f@_flux(field, total) - before) / dt) : miss;
}

/* The new effective field: regula falsi with halving, in a bracket that cannot lose the root. */
static double @f@_field(const double *s, double sign, double u, double before, double dt)
{
    double low = fmin((u - fabs(@M@_LIFT)) / @M@_RISE, s[0]), high = fmax((u + fabs(@M@_LIFT)) / @M@_RISE, s[0]);
    double below, above;
    if (sign == 0)
        return s[0];
    if (sign > 0)
        low = s[0];
    else
        high = s[0];
    below = @f@_miss(s, sign, low, u, before, dt);
    above = @f@_miss(s, sign, high, u, before, dt);
    for (int i = 0; i < 200 && high - low > 4e-16 * fmax(fabs(low), fabs(high)); i++) {
        double middle = i % 3 == 2 || !(above > below) ? 0.5 * (low + high) : low - below * (high - low) / (above - below);
        double miss;
        if (!(middle > low && middle < high))
            middle = 0.5 * (low + high);
        miss = @f@_miss(s, sign, middle, u, before, dt);
        if (miss == 0)
            return middle;
        if (miss < 0)
            low = middle, below = miss;
        else
            high = middle, above = miss;
    }
    return fabs(below) < fabs(above) ? low : high;
}

/* From the input u0, with which the state is in equilibrium, to u1. */
static void @f@_move(const double *s, double u0, double u1, double before, double dt, double *next)
{
    const double sign = u1 > u0 ? 1 : u1 < u0 ? -1 : 0, field = @f@_field(s, sign, u1, before, dt);
    next[1] = @f@_irreversible(s, sign, field);
    next[0] = field;
}

static void @f@_init(double *s, double u0)
{
    s[0] = s[1] = 0;
    for (int i = 0; i < @M@_FIRST_CURVE; i++)
        @f@_move(s, u0 * i / @M@_FIRST_CURVE, u0 * (i + 1) / @M@_FIRST_CURVE, 0, 0, s);
}

static double @f@_magnetized(const double *s)
{
    return @M@_C * @f@_anhysteretic(s[0]) + (1 - @M@_C) * s[1];
}

static double @f@_step(const double *s, double u0, double u1, double dt, double *next)
{
    double moved[2] = {s[0], s[1]};
#if @M@_DYNAMIC
    const double total = @f@_magnetized(s);
    (void)u0;
    if (dt > 0)
        @f@_move(s, @M@_RISE * s[0] + @M@_LIFT * total, u1, @f@_flux(s[0], total), dt, moved);
#else
    (void)dt;
    @f@_move(s, u0, u1, 0, 0, moved);
#endif
    if (next) {
        next[0] = moved[0];
        next[1] = moved[1];
    }
    return @M@_OFFSET + @M@_OF_INPUT * u1 + @f@_flux(moved[0], @f@_magnetized(moved));
}
