/* Which small motions explain where the edges were measured?  pose_solver.py is the reference. */
#include "kernel.h"

#define UNKNOWNS 4
#define ROBUST_STEPS 8
#define CONVERGED_MM 1e-5
#define TUKEY 4.7
#define MAX_PIECES 4096

static int invert(double a[UNKNOWNS][UNKNOWNS], double inverse[UNKNOWNS][UNKNOWNS])
{
    for (int i = 0; i < UNKNOWNS; i++)
        for (int j = 0; j < UNKNOWNS; j++)
            inverse[i][j] = i == j;
    for (int i = 0; i < UNKNOWNS; i++) {
        if (!(a[i][i] > 0.0))
            return 0;
        const double pivot = 1.0 / a[i][i];
        for (int j = 0; j < UNKNOWNS; j++) {
            a[i][j] *= pivot;
            inverse[i][j] *= pivot;
        }
        for (int k = 0; k < UNKNOWNS; k++) {
            if (k == i)
                continue;
            const double factor = a[k][i];
            for (int j = 0; j < UNKNOWNS; j++) {
                a[k][j] -= factor * a[i][j];
                inverse[k][j] -= factor * inverse[i][j];
            }
        }
    }
    return 1;
}

/* The element that sorting would bring to place k; reorders the values. */
double slabcell_nth(double *values, int n, int k)
{
    int low = 0, high = n - 1;
    while (low < high) {
        const double pivot = values[(low + high) / 2];
        int i = low, j = high;
        while (i <= j) {
            while (values[i] < pivot)
                i++;
            while (values[j] > pivot)
                j--;
            if (i <= j) {
                const double swap = values[i];
                values[i++] = values[j];
                values[j--] = swap;
            }
        }
        if (k <= j)
            high = j;
        else if (k >= i)
            low = i;
        else
            break;
    }
    return values[k];
}

/* `measured` holds distance (mm), sigma (mm) and valid of each piece; `changes` (outlines, 4), `covariances`
 * (outlines, 4, 4), `spreads` (outlines) and `remaining` (pieces) are written. */
void slabcell_solve(int outlines, const int64_t *starts, const double *extras, const double *measured, double prior,
                    double *changes, double *covariances, double *spreads, double *remaining)
{
    static const double nothing[UNKNOWNS] = {0};
    for (int o = 0; o < outlines; o++) {
        const int64_t first = starts[o];
        const int n = (int)(starts[o + 1] - first);
        const double *row = extras + EXTRA_FIELDS * first, *given = measured + 3 * first;
        double *left = remaining + first, *change = changes + UNKNOWNS * (ptrdiff_t)o;
        double *covariance = covariances + UNKNOWNS * UNKNOWNS * (ptrdiff_t)o;
        double weight[MAX_PIECES], sorted[MAX_PIECES];
        double arm = 1.0, spread = 0.0;
        double inverse[UNKNOWNS][UNKNOWNS];
        memcpy(change, nothing, sizeof nothing);
        memset(covariance, 0, sizeof inverse);
        spreads[o] = 0.0;
        if (n > MAX_PIECES)
            continue;
        for (int i = 0; i < n; i++) {
            arm = fmax(arm, fabs(row[EXTRA_FIELDS * i + ROW_TURN]));
            weight[i] = given[3 * i + 2] > 0.5 ? 1.0 / (given[3 * i + 1] * given[3 * i + 1]) : 0.0;
            left[i] = given[3 * i];
        }
        for (int step = 0; step < ROBUST_STEPS; step++) {
            double normal[UNKNOWNS][UNKNOWNS] = {{0}}, right[UNKNOWNS] = {0};
            for (int i = 0; i < n; i++) {
                const double *r = row + EXTRA_FIELDS * i;
                const double scaled[UNKNOWNS] = {r[ROW_X], r[ROW_Y], r[ROW_TURN] / arm, r[ROW_KERF]};
                for (int p = 0; p < UNKNOWNS; p++) {
                    const double w = weight[i] * scaled[p];
                    right[p] += w * given[3 * i];
                    for (int q = 0; q <= p; q++)
                        normal[p][q] += w * scaled[q];
                }
            }
            for (int p = 0; p < UNKNOWNS; p++) {
                for (int q = 0; q < p; q++)
                    normal[q][p] = normal[p][q];
                normal[p][p] += prior;
            }
            if (!invert(normal, inverse))
                break;
            double moved = 0.0;
            for (int p = 0; p < UNKNOWNS; p++) {
                double now = 0.0;
                for (int q = 0; q < UNKNOWNS; q++)
                    now += inverse[p][q] * right[q];
                moved = fmax(moved, fabs(now - change[p]));
                change[p] = now;
            }
            int usable = 0;
            for (int i = 0; i < n; i++) {
                const double *r = row + EXTRA_FIELDS * i;
                left[i] = given[3 * i]
                          - (r[ROW_X] * change[0] + r[ROW_Y] * change[1] + r[ROW_TURN] / arm * change[2] + change[3]);
                if (given[3 * i + 2] > 0.5)
                    sorted[usable++] = fabs(left[i]) / given[3 * i + 1];
            }
            spread = usable ? slabcell_nth(sorted, usable, usable / 2) / 0.6745 : 0.0;
            if (step > 0 && moved < CONVERGED_MM)
                break;
            const double cut = TUKEY * fmax(spread, 1.0);
            for (int i = 0; i < n; i++) {
                const double sigma = given[3 * i + 1], away = fabs(left[i]) / sigma / cut;
                const double robust = fmax(1.0 - away * away, 0.0);
                weight[i] = given[3 * i + 2] > 0.5 ? robust * robust / (sigma * sigma) : 0.0;
            }
        }
        const double unscale[UNKNOWNS] = {1.0, 1.0, 1.0 / arm, 1.0};
        spreads[o] = spread;
        for (int p = 0; p < UNKNOWNS; p++) {
            for (int q = 0; q < UNKNOWNS; q++)
                covariance[UNKNOWNS * p + q] = inverse[p][q] * unscale[p] * unscale[q];
        }
        for (int p = 0; p < UNKNOWNS; p++)
            change[p] *= unscale[p];
    }
}
