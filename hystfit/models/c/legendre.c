/* Sum of c_i P_i(x) by Clenshaw's recurrence. */
static double legendre(const double *c, int n, double x)
{
    double later = 0, latest = 0, old;
    int i;
    for (i = n - 1; i > 0; i--) {
        old = latest;
        latest = c[i] + (2 * i + 1) / (i + 1.0) * x * latest - (i + 1) / (i + 2.0) * later;
        later = old;
    }
    return n > 1 ? c[0] + x * latest - 0.5 * later : c[0];
}
