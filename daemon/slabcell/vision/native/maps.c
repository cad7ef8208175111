/* How does the camera map a small part of the table?  local_map.py is the reference. */
#include "kernel.h"

#define MAX_NODES 64

/* Cubic weights of four neighbours in a row, for a place `t` between the middle two. */
static inline void cubic(double t, double *w)
{
    w[0] = -t * (t - 1.0) * (t - 2.0) / 6.0;
    w[1] = (t + 1.0) * (t - 1.0) * (t - 2.0) / 2.0;
    w[2] = -(t + 1.0) * t * (t - 2.0) / 2.0;
    w[3] = (t + 1.0) * t * (t - 1.0) / 6.0;
}

/* Whether the table reaches `size` mm around a point. */
static inline int holds(const Forward *t, double x, double y, double size)
{
    return x - size >= t->x0 && x + size <= t->x0 + t->pitch * (t->columns - 1) && y - size >= t->y0
           && y + size <= t->y0 + t->pitch * (t->rows - 1);
}

/* The pixels of top and foot of a point of the table, from the 16 samples around it. */
static inline void seen_at(const Forward *t, double x, double y, const int channels, double *sum)
{
    const double a = (x - t->x0) / t->pitch, b = (y - t->y0) / t->pitch, fa = floor(a), fb = floor(b);
    const int column = !(fa >= 1.0) ? 1 : fa > t->columns - 3 ? t->columns - 3 : (int)fa;
    const int row = !(fb >= 1.0) ? 1 : fb > t->rows - 3 ? t->rows - 3 : (int)fb;
    double wa[4], wb[4];
    cubic(a - column, wa);
    cubic(b - row, wb);
    for (int k = 0; k < channels; k++)
        sum[k] = 0.0;
    for (int j = 0; j < 4; j++) {
        const double *line = t->grid + 4 * ((ptrdiff_t)(row - 1 + j) * t->columns + column - 1);
        for (int k = 0; k < channels; k++)
            sum[k] += wb[j] * (wa[0] * line[k] + wa[1] * line[4 + k] + wa[2] * line[8 + k] + wa[3] * line[12 + k]);
    }
}

/* The pixels of top and foot of one point of the table.  Returns 0 if the table does not hold it. */
int slabcell_seen(const Forward *table, double x, double y, double pixels[4])
{
    if (!holds(table, x, y, 0.0))
        return 0;
    seen_at(table, x, y, 4, pixels);
    return 1;
}

/* `pixels` (n, 2): where points (n, 2) of the upper plane are seen.  Returns 0 if the table does not hold them all. */
int slabcell_to_pixels(const Forward *table, int64_t count, const double *points, double *pixels)
{
    for (int64_t i = 0; i < count; i++) {
        double sum[2];
        if (!holds(table, points[2 * i], points[2 * i + 1], 0.0))
            return 0;
        seen_at(table, points[2 * i], points[2 * i + 1], 2, sum);
        pixels[2 * i] = sum[0];
        pixels[2 * i + 1] = sum[1];
    }
    return 1;
}

/* `nodes` (n, 2) are places in -1 ... 1, `inverse` (terms, n) makes polynomials of what is found there.  Writes a row for
 * each place: centre, size, polynomials of top and foot (terms, 2).  Returns 0 if the table does not hold them all. */
int slabcell_local_maps(const Forward *table, int count, const double *nodes, const double *inverse, int places,
                        const double *centres, const double *sizes, double *maps)
{
    for (int p = 0; p < places; p++) {
        double seen[MAX_NODES][4], *map = maps + (ptrdiff_t)MAP_FIELDS * p;
        const double size = sizes[p], x = centres[2 * p], y = centres[2 * p + 1];
        if (!holds(table, x, y, size))
            return 0;
        for (int n = 0; n < count; n++) {
            if (table->flat)
                seen_at(table, x + size * nodes[2 * n], y + size * nodes[2 * n + 1], 2, seen[n]);
            else
                seen_at(table, x + size * nodes[2 * n], y + size * nodes[2 * n + 1], 4, seen[n]);
        }
        map[MAP_X] = x;
        map[MAP_Y] = y;
        map[MAP_SIZE] = size;
        for (int t = 0; t < TERMS; t++) {
            double sum[4] = {0};
            for (int n = 0; n < count; n++)
                for (int k = 0; k < (table->flat ? 2 : 4); k++)
                    sum[k] += inverse[t * count + n] * seen[n][k];
            map[MAP_TOP + 2 * t] = sum[0];
            map[MAP_TOP + 2 * t + 1] = sum[1];
            map[MAP_FOOT + 2 * t] = table->flat ? sum[0] : sum[2];
            map[MAP_FOOT + 2 * t + 1] = table->flat ? sum[1] : sum[3];
        }
    }
    return 1;
}
