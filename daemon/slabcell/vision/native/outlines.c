/* How do outlines look on the table, in numbers?  describe.py, outline.py and plane.py are the references. */
#include "kernel.h"

void slabcell_spectra(int64_t shapes, const double *samples, const double *roots, double *spectra, double *energies,
                      double *magnitudes);

#define MAX_FFT 256

/* Bilinear in a table of the plane: `grid` (rows, columns, 2) holds the mm at every `pitch`-th pixel. */
void slabcell_to_plane(const double *grid, int rows, int columns, double pitch, int64_t count, const double *pixels,
                       double *mm)
{
    const double scale = 1.0 / pitch;
    for (int64_t i = 0; i < count; i++) {
        const double a = pixels[2 * i] * scale, b = pixels[2 * i + 1] * scale;
        const double fa = floor(a), fb = floor(b);
        const int column = fa < 0.0 ? 0 : fa > columns - 2 ? columns - 2 : (int)fa;
        const int row = fb < 0.0 ? 0 : fb > rows - 2 ? rows - 2 : (int)fb;
        const double right = a - column, down = b - row;
        const double *upper = grid + 2 * ((ptrdiff_t)row * columns + column), *lower = upper + 2 * (ptrdiff_t)columns;
        for (int k = 0; k < 2; k++) {
            const double first = upper[k] + right * (upper[k + 2] - upper[k]);
            const double second = lower[k] + right * (lower[k + 2] - lower[k]);
            mm[2 * i + k] = first + down * (second - first);
        }
    }
}

/* Fast Fourier transform of n = 2^k complex numbers in place, n at most MAX_FFT; `roots` holds exp(-2πi·j/most), most/2
 * of them.  Stockham's order, which needs no bit reversal and reads and writes side by side: C. Van Loan, "Computational
 * frameworks for the fast Fourier transform", SIAM 1992, section 1.7. */
void slabcell_fft(double *values, int n, const double *roots, int most, int inverse)
{
    double rooms[4][MAX_FFT], *re = rooms[0], *im = rooms[1], *next_re = rooms[2], *next_im = rooms[3];
    const double sign = inverse ? -1.0 : 1.0;
    for (int i = 0; i < n; i++) {
        re[i] = values[2 * i];
        im[i] = values[2 * i + 1];
    }
    for (int groups = n / 2, size = 1; groups >= 1; groups /= 2, size *= 2) {
        const int stride = most / (2 * groups);
        for (int p = 0; p < groups; p++) {
            const double c = roots[2 * (p * stride)], s = sign * roots[2 * (p * stride) + 1];
            const double *restrict are = re + size * p, *restrict aim = im + size * p;
            const double *restrict bre = are + size * groups, *restrict bim = aim + size * groups;
            double *restrict sum_re = next_re + 2 * size * p, *restrict sum_im = next_im + 2 * size * p;
            double *restrict turned_re = sum_re + size, *restrict turned_im = sum_im + size;
            for (int q = 0; q < size; q++) {
                const double dre = are[q] - bre[q], dim = aim[q] - bim[q];
                sum_re[q] = are[q] + bre[q];
                sum_im[q] = aim[q] + bim[q];
                turned_re[q] = c * dre - s * dim;
                turned_im[q] = c * dim + s * dre;
            }
        }
        double *const old_re = re, *const old_im = im;
        re = next_re;
        im = next_im;
        next_re = old_re;
        next_im = old_im;
    }
    for (int i = 0; i < n; i++) {
        values[2 * i] = re[i];
        values[2 * i + 1] = im[i];
    }
}

/* Turns a ring counter-clockwise and returns its area; fills centroid and normalised polar inertia. */
static double measure(double *ring, int64_t count, double *centroid, double *inertia)
{
    const double x0 = ring[0], y0 = ring[1];
    double cross_sum = 0.0, cx = 0.0, cy = 0.0, polar = 0.0;
    double x = ring[2 * count - 2] - x0, y = ring[2 * count - 1] - y0;
    for (int64_t i = 0; i < count; i++) {
        const double xn = ring[2 * i] - x0, yn = ring[2 * i + 1] - y0;
        const double cross = x * yn - xn * y;
        cross_sum += cross;
        cx += (x + xn) * cross;
        cy += (y + yn) * cross;
        polar += (x * x + x * xn + xn * xn + y * y + y * yn + yn * yn) * cross;
        x = xn;
        y = yn;
    }
    const double area = 0.5 * cross_sum;
    if (fabs(area) < 1e-12) {
        centroid[0] = x0;
        centroid[1] = y0;
        *inertia = INFINITY;
        return 0.0;
    }
    cx /= 6.0 * area;
    cy /= 6.0 * area;
    *inertia = fabs(polar / 12.0 - area * (cx * cx + cy * cy)) / (area * area);
    centroid[0] = cx + x0;
    centroid[1] = cy + y0;
    if (area < 0.0)
        for (int64_t i = 0, j = count - 1; i < j; i++, j--)
            for (int k = 0; k < 2; k++) {
                const double swap = ring[2 * i + k];
                ring[2 * i + k] = ring[2 * j + k];
                ring[2 * j + k] = swap;
            }
    return fabs(area);
}

/* `count` points at equal distances along a closed ring, from its first point on.  `along` has room for a number a point. */
static void resample(const double *ring, int64_t points, int count, double *along, double *samples)
{
    for (int64_t i = 0; i + 1 < points; i++) {
        const double dx = ring[2 * i + 2] - ring[2 * i], dy = ring[2 * i + 3] - ring[2 * i + 1];
        along[i] = sqrt(dx * dx + dy * dy);
    }
    const double dx = ring[0] - ring[2 * points - 2], dy = ring[1] - ring[2 * points - 1];
    along[points - 1] = sqrt(dx * dx + dy * dy);
    double length = 0.0;
    for (int64_t i = 0; i < points; i++)
        length += along[i];
    double reached = 0.0, passed = 0.0;
    int64_t i = -1;
    const double *a = ring, *b = ring;
    for (int k = 0; k < count; k++) {
        const double at = length * ((double)k / count);
        while (reached <= at && i + 1 < points) {
            i++;
            passed = reached;
            reached += along[i];
        }
        a = ring + 2 * i;
        b = i + 1 < points ? a + 2 : ring;
        double share = (at - passed) / fmax(along[i], 1e-12);
        share = share < 0.0 ? 0.0 : share > 1.0 ? 1.0 : share;
        samples[2 * k] = a[0] + share * (b[0] - a[0]);
        samples[2 * k + 1] = a[1] + share * (b[1] - a[1]);
    }
}

/* Outlines in pixels, each from `starts` on, become those of the upper faces, `count` points each.  Walls that are seen
 * less than `least_mm` wide stay.  `scratch` has room for three numbers a point of the longest, and two a sample.  Returns
 * 0 if the table does not hold them all. */
int slabcell_strip_walls(const double *grid, int rows, int columns, double pitch, const Forward *table, int64_t rings,
                         const int64_t *starts, const double *pixels, int count, double least_mm, double facing,
                         double *scratch, double *stripped)
{
    for (int64_t r = 0; r < rings; r++) {
        const int64_t size = starts[r + 1] - starts[r];
        double *ring = scratch, *samples = scratch + 2 * size, *along = samples + 2 * count;
        double *mine = stripped + 2 * (ptrdiff_t)count * r;
        double centroid[2], inertia, seen[4], ends[4];
        slabcell_to_plane(grid, rows, columns, pitch, size, pixels + 2 * starts[r], ring);
        measure(ring, size, centroid, &inertia);
        if (!slabcell_seen(table, centroid[0], centroid[1], seen))
            return 0;
        slabcell_to_plane(grid, rows, columns, pitch, 2, seen, ends);
        const double sx = ends[2] - ends[0], sy = ends[3] - ends[1], width = sqrt(sx * sx + sy * sy);
        resample(ring, size, count, along, samples);
        for (int i = 0; i < count; i++) {
            const double *after = samples + 2 * ((i + 2) % count), *before = samples + 2 * ((i + count - 2) % count);
            const double tx = after[0] - before[0], ty = after[1] - before[1];
            const double length = fmax(sqrt(tx * tx + ty * ty), 1e-9);
            double share = width < least_mm ? 0.0 : (ty * sx - tx * sy) / (length * fmax(width, 1e-9)) / facing;
            share = share < 0.0 ? 0.0 : share > 1.0 ? 1.0 : share;
            mine[2 * i] = samples[2 * i] - share * sx;
            mine[2 * i + 1] = samples[2 * i + 1] - share * sy;
        }
    }
    return 1;
}

/* Of each ring, points `begins` to `ends` of `points`: `count` samples minus their mean, the mean, area and inertia, and
 * centroid.  The points are mm, or pixels if there is a `grid`; of long rings only every second or third is looked at, so
 * that `enough` are left.  `scratch` has room for two of the longest ring.  Then their spectra, as in matching.c. */
void slabcell_describe(const double *grid, int rows, int columns, double pitch, int64_t rings, const int64_t *begins,
                       const int64_t *ends, const double *points, int64_t enough, int count, double *scratch,
                       double *samples, double *middles, double *areas, double *inertias, double *centroids,
                       const double *roots, double *spectra, double *energies, double *magnitudes)
{
    for (int64_t r = 0; r < rings; r++) {
        double *mine = samples + 2 * (ptrdiff_t)count * r;
        const double *ring = points + 2 * begins[r];
        const int64_t all = ends[r] - begins[r], every = all / enough > 1 ? all / enough : 1;
        const int64_t size = (all + every - 1) / every;
        double *taken = grid ? scratch + 2 * size : scratch;
        for (int64_t i = 0; i < size; i++) {
            taken[2 * i] = ring[2 * every * i];
            taken[2 * i + 1] = ring[2 * every * i + 1];
        }
        if (grid)
            slabcell_to_plane(grid, rows, columns, pitch, size, taken, scratch);
        areas[r] = measure(scratch, size, centroids + 2 * r, inertias + r);
        resample(scratch, size, count, scratch + 2 * size, mine);
        double x = 0.0, y = 0.0;
        for (int k = 0; k < count; k++) {
            x += mine[2 * k];
            y += mine[2 * k + 1];
        }
        x /= count;
        y /= count;
        for (int k = 0; k < count; k++) {
            mine[2 * k] -= x;
            mine[2 * k + 1] -= y;
        }
        middles[2 * r] = x;
        middles[2 * r + 1] = y;
    }
    slabcell_spectra(rings, samples, roots, spectra, energies, magnitudes);
}
