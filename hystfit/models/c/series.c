/* @doc@ */
static void @f@_init(double *s, double u0)
{
    double signal = u0;
@init@    (void)signal;
}

static double @f@_step(const double *s, double u0, double u1, double dt, double *next)
{
    double signal = u1, before = u0, y = 0;
@step@    (void)before;
    (void)signal;
    return y;
}
