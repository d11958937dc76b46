/* A straight line. */
static void @f@_init(double *s, double u0)
{
    (void)s;
    (void)u0;
}

static double @f@_step(const double *s, double u0, double u1, double dt, double *next)
{
    (void)s;
    (void)u0;
    (void)dt;
    (void)next;
    return @M@_K * u1;
}
