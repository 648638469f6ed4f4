/* Controls of plans: the spline through the nodes of each plan, clipped to [-1, 1], then scaled to the model's units. */

/* nodes: n plans of m rows of nu numbers; weights: steps rows of m; controls: n plans of steps rows of nu */
void piaffe_controls(const double *nodes, long n, long m, long nu, const double *weights, long steps,
                     const double *centre, const double *half, double *restrict controls)
{
    for (long i = 0; i < n; i++)
        for (long s = 0; s < steps; s++) {
            const double *own = nodes + i * m * nu, *weight = weights + s * m;
            double *to = controls + (i * steps + s) * nu;
            for (long c = 0; c < nu; c++)
                to[c] = weight[0] * own[c];
            for (long j = 1; j < m; j++)
                for (long c = 0; c < nu; c++)
                    to[c] += weight[j] * own[j * nu + c];
            for (long c = 0; c < nu; c++) {
                double u = to[c] > 1.0 ? 1.0 : to[c];
                u = u < -1.0 ? -1.0 : u;
                to[c] = centre[c] + half[c] * u;
            }
        }
}
