/* A single-valued curve: a line, and cubic polynomials between knots. */
static void @f@_init(double *s, double u0)
{
    (void)s;
    (void)u0;
}

static double @f@_step(const double *s, double u0, double u1, double dt, double *next)
{
    const double x = (u1 - @M@_LOW) / (@M@_HIGH - @M@_LOW);
    double y = @M@_OFFSET + @M@_SLOPE * x;
    int k;
    (void)s;
    (void)u0;
    (void)dt;
    (void)next;
    for (k = 0; k < @M@_KNOTS_SIZE; k++) {
        const double beyond = fmax(0, x - @f@_knots[k]);
        y += beyond * beyond * (@f@_squares[k] + beyond * @f@_cubes[k]);
    }
    return y;
}
