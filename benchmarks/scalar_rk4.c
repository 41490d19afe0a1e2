/* The drive as one would write it down in C: RK4 at a fixed step, PI every sample.
 * Mesh by Eq. 21, friction by Eq. 25; below REST a body rests and friction balances it.
 * p: as `simulator.py` lays it out. out: (n, 3) ring angle, ring speed, left pinion angle. */
#include <math.h>

#define REST 1e-5 /* rad/s */

static double mesh(double z, double rate, double k, double c, double cf, double gap)
{
    double side = z >= 0.0 ? 1.0 : -1.0, closing = side * rate, pressed = k * (side * z - gap);
    int touch = pressed + c * closing > 0.0;
    if (touch && closing > 0.0 && pressed < cf * closing) {
        double flight = (z + side * gap) / rate + c / k;
        double decay = exp(-k / (c + cf) * fmax(flight, 0.0));
        touch = side * (z + ((c + cf) * decay - cf) / k * rate) >= gap;
    }
    return touch ? k * (z - side * gap) + c * rate : cf * rate;
}

static double acceleration(double v, double net, double inertia, const double *law)
{
    double sign = v > REST ? 1.0 : v < -REST ? -1.0 : net > 0.0 ? 1.0 : -1.0;
    const double *f = sign > 0.0 ? law : law + 4; /* static, Coulomb, speed, viscous */
    double speed = fabs(v);
    if (speed <= REST && fabs(net) <= f[0]) return 0.0;
    if (speed <= REST) speed = 0.0;
    return (net - sign * (f[1] + (f[0] - f[1]) * exp(-speed / f[2]) + f[3] * speed)) / inertia;
}

static void rate(const double *x, const double *u, const double *p, double *dx)
{
    double n2 = p[1], k = p[4], c = p[5], cf = p[6];
    double left = mesh(x[0] - n2 * x[2], x[3] - n2 * x[5], k, c, cf, p[7]);
    double right = mesh(x[1] - n2 * x[2], x[4] - n2 * x[5], k, c, cf, p[8]);
    double net[3] = {p[0] * u[0] - left, p[0] * u[1] - right, n2 * (left + right)};
    for (int i = 0; i < 3; i++) {
        double v = x[3 + i];
        dx[3 + i] = acceleration(v, net[i], i < 2 ? p[2] : p[3], p + (i < 2 ? 9 : 17));
        dx[i] = fabs(v) <= REST && dx[3 + i] == 0.0 ? 0.0 : v;
    }
}

void run(const double *p, const double *loop, const double *target, long n, long substeps,
         double dt, double *out)
{
    double x[6] = {0}, integral = 0.0, h = dt / substeps;
    for (long i = 0; i < n; i++) {
        out[3 * i] = x[2], out[3 * i + 1] = x[5], out[3 * i + 2] = x[0];
        double error = target[i] - x[5];
        integral += error * dt;
        double common = fmin(fmax(loop[0] * error + loop[1] * integral, -loop[2]), loop[2]);
        double u[2] = {common + loop[3], common + loop[4]};
        for (long s = 0; s < substeps; s++) {
            double a[6], b[6], c[6], d[6], y[6];
            rate(x, u, p, a);
            for (int j = 0; j < 6; j++) y[j] = x[j] + 0.5 * h * a[j];
            rate(y, u, p, b);
            for (int j = 0; j < 6; j++) y[j] = x[j] + 0.5 * h * b[j];
            rate(y, u, p, c);
            for (int j = 0; j < 6; j++) y[j] = x[j] + h * c[j];
            rate(y, u, p, d);
            for (int j = 0; j < 6; j++) x[j] += h / 6.0 * (a[j] + 2.0 * (b[j] + c[j]) + d[j]);
        }
    }
}
