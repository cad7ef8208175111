/* Which outline is which, and turned how?  matching.py is the reference. */
#include "kernel.h"

#define SAMPLES 128
#define FINE 256
#define HARMONICS 24 /* on both sides together, of which magnitudes are compared first */
#define MAX_ROTATIONS 4
#define REFINEMENTS 3
#define WINDOW 3
#define STILL 0.2 /* floors: what moves by less lies still */
#define FAR 20.0 /* floors: a distance counts no more than this */
#define EVERY 2 /* of the blob's samples one of two is compared */

void slabcell_fft(double *values, int n, const double *roots, int most, int inverse);

enum { SHAPE_X, SHAPE_Y, SHAPE_AREA, SHAPE_INERTIA, SHAPE_FIELDS };

typedef struct {
    double area, inertia; /* greatest differences of the logarithms */
    double worse, margin; /* how much worse than the best of a blob another may be: factor and mm */
    double same;          /* rotations that differ by less (radians) are one */
    double floor;         /* mm: what an outline scatters at least */
    double close;         /* mm: by how much more than the best of a blob another may be off once laid over it */
} Limits;

typedef struct {
    int slot, start;
    double rotation, x, y, distance;
} Peak;

/* The spectrum of `samples`, its energy, and the magnitudes of its low harmonics. */
void slabcell_spectra(int64_t shapes, const double *samples, const double *roots, double *spectra, double *energies,
                      double *magnitudes)
{
    for (int64_t i = 0; i < shapes; i++) {
        double *mine = spectra + 2 * SAMPLES * i, *low = magnitudes + HARMONICS * i;
        memcpy(mine, samples + 2 * SAMPLES * i, 2 * SAMPLES * sizeof(double));
        slabcell_fft(mine, SAMPLES, roots, FINE, 0);
        double energy = 0.0;
        for (int k = 0; k < 2 * SAMPLES; k++)
            energy += mine[k] * mine[k];
        energies[i] = energy;
        for (int k = 0; k < HARMONICS / 2; k++) {
            const double *up = mine + 2 * (k + 1), *down = mine + 2 * (SAMPLES - 1 - k);
            low[2 * k] = sqrt(up[0] * up[0] + up[1] * up[1]);
            low[2 * k + 1] = sqrt(down[0] * down[0] + down[1] * down[1]);
        }
    }
}

/* The rotations of one slot's outline in which it lies over the blob's within the limit, best first; at most
 * MAX_ROTATIONS of them. */
static int peaks(const double *blob, double blob_energy, const double *slot, double slot_energy, double limit,
                 const double *roots, Peak *found)
{
    double overlap[2 * FINE] = {0}, strength[FINE];
    for (int k = 0; k < SAMPLES; k++) {
        const int at = k < SAMPLES / 2 ? k : k + FINE - SAMPLES;
        const double *b = blob + 2 * k, *s = slot + 2 * k;
        overlap[2 * at] = b[0] * s[0] + b[1] * s[1];
        overlap[2 * at + 1] = b[1] * s[0] - b[0] * s[1];
    }
    slabcell_fft(overlap, FINE, roots, FINE, 1);
    const double scale = 1.0 / ((double)SAMPLES * SAMPLES), energy = (blob_energy + slot_energy) * scale;
    for (int i = 0; i < FINE; i++)
        strength[i] = scale * sqrt(overlap[2 * i] * overlap[2 * i] + overlap[2 * i + 1] * overlap[2 * i + 1]);
    int count = 0;
    for (int i = 0; i < FINE; i++) {
        const double here = strength[i], square = energy - 2.0 * here;
        if (square > limit * limit || here < strength[(i + FINE - 1) % FINE] || here <= strength[(i + 1) % FINE])
            continue;
        const Peak peak = {0, i, atan2(overlap[2 * i + 1], overlap[2 * i]), 0.0, 0.0, sqrt(fmax(square, 0.0))};
        int at = count < MAX_ROTATIONS ? count++ : MAX_ROTATIONS;
        for (; at > 0 && found[at - 1].distance > peak.distance; at--)
            if (at < MAX_ROTATIONS)
                found[at] = found[at - 1];
        if (at < MAX_ROTATIONS)
            found[at] = peak;
    }
    return count;
}

typedef struct {
    double least;
    int64_t slot;
} Bound;

static int solve4(double a[4][4], double b[4])
{
    for (int i = 0; i < 4; i++) {
        if (!(a[i][i] > 1e-12))
            return 0;
        for (int k = i + 1; k < 4; k++) {
            const double factor = a[k][i] / a[i][i];
            for (int j = i; j < 4; j++)
                a[k][j] -= factor * a[i][j];
            b[k] -= factor * b[i];
        }
    }
    for (int i = 3; i >= 0; i--) {
        for (int j = i + 1; j < 4; j++)
            b[i] -= a[i][j] * b[j];
        b[i] /= a[i][i];
    }
    return 1;
}

/* Lays the slot's outline over the blob's by the distances along its normals, a uniform offset left free: Gauss-Newton
 * with Cauchy's weights.  `x`, `y`: where the mean of the slot's samples lies, beside the mean of the blob's; the distance
 * becomes the root mean square of those along the normals, before the last step, far ones cut. */
static void refine(const double *blob, const double *slot, const double *normals, double floor, Peak *peak)
{
    const int shift = (peak->start * SAMPLES + FINE / 2) / FINE;
    double spread = 8.0 * floor;
    for (int step = 0; step < REFINEMENTS; step++) {
        const double c = cos(peak->rotation), s = sin(peak->rotation);
        double normal[4][4] = {{0}}, right[4] = {0}, reach = 1.0, sum = 0.0, weights = 0.0, squares = 0.0;
        double px[SAMPLES], py[SAMPLES], nx[SAMPLES], ny[SAMPLES];
        for (int k = 0; k < SAMPLES; k++) {
            px[k] = c * slot[2 * k] - s * slot[2 * k + 1];
            py[k] = s * slot[2 * k] + c * slot[2 * k + 1];
            nx[k] = c * normals[2 * k] - s * normals[2 * k + 1];
            ny[k] = s * normals[2 * k] + c * normals[2 * k + 1];
            reach = fmax(reach, fabs(px[k]) + fabs(py[k]));
        }
        for (int j = 0; j < SAMPLES; j += EVERY) {
            const double bx = blob[2 * j] - peak->x, by = blob[2 * j + 1] - peak->y;
            int nearest = 0;
            double least = INFINITY;
            for (int k = j - shift - WINDOW; k <= j - shift + WINDOW; k++) {
                const int at = (k + 2 * SAMPLES) & (SAMPLES - 1);
                const double dx = bx - px[at], dy = by - py[at], square = dx * dx + dy * dy;
                if (square < least) {
                    least = square;
                    nearest = at;
                }
            }
            const double n0 = nx[nearest], n1 = ny[nearest];
            const double away = n0 * (bx - px[nearest]) + n1 * (by - py[nearest]);
            const double row[4] = {n0, n1, (n1 * bx - n0 * by) / reach, 1.0};
            const double weight = 1.0 / (1.0 + (away / spread) * (away / spread));
            for (int p = 0; p < 4; p++) {
                right[p] += weight * row[p] * away;
                for (int q = 0; q < 4; q++)
                    normal[p][q] += weight * row[p] * row[q];
            }
            sum += weight * fmin(fabs(away), 4.0 * spread);
            squares += fmin(away * away, FAR * FAR * floor * floor);
            weights += weight;
        }
        for (int p = 0; p < 4; p++)
            normal[p][p] += 1e-3;
        if (!solve4(normal, right))
            return;
        peak->distance = sqrt(squares * EVERY / SAMPLES);
        peak->x += right[0];
        peak->y += right[1];
        peak->rotation += right[2] / reach;
        if (step > 0 && fmax(fmax(fabs(right[0]), fabs(right[1])), fabs(right[2])) < STILL * floor)
            return;
        spread = fmax(2.0 * floor, fmin(spread, 2.0 * sum / fmax(weights, 1e-9)));
    }
}

static int same_rotation(const Peak *a, const Peak *b, double symmetry, double same)
{
    const double step = TURN / symmetry;
    const double turns = (a->rotation - b->rotation) / step;
    return fabs(turns - nearbyint(turns)) * step <= same;
}

/* Writes what each blob may be, at most `room` rows of CANDIDATE_FIELDS, and returns how many there are.  `shapes` hold
 * SHAPE_FIELDS of each outline, `allowed` (blobs, slots) which pairs to compare, or is null: those that agree. */
int64_t slabcell_match(int64_t blobs, const double *blob_shapes, const double *blob_samples, const double *blob_spectra,
                       const double *blob_energies, const double *blob_magnitudes, int64_t slots,
                       const double *slot_shapes, const double *slot_samples, const double *slot_spectra,
                       const double *slot_energies, const double *slot_magnitudes, const double *slot_normals,
                       const double *slot_limits, const double *slot_symmetries, const uint8_t *allowed,
                       const Limits *limits, const double *roots, double *scratch, int64_t room, double *found)
{
    int64_t written = 0;
    double *log_area = scratch, *log_inertia = scratch + slots;
    Bound *bounds = (Bound *)(scratch + 2 * slots);
    for (int64_t s = 0; s < slots; s++) {
        log_area[s] = log(slot_shapes[SHAPE_FIELDS * s + SHAPE_AREA]);
        log_inertia[s] = log(slot_shapes[SHAPE_FIELDS * s + SHAPE_INERTIA]);
    }
    Peak *all = (Peak *)(scratch + 4 * slots); /* MAX_ROTATIONS for each slot */
    for (int64_t b = 0; b < blobs; b++) {
        const double *shape = blob_shapes + SHAPE_FIELDS * b, *low = blob_magnitudes + HARMONICS * b;
        const double area = log(shape[SHAPE_AREA]), inertia = log(shape[SHAPE_INERTIA]);
        int64_t count = 0, hopeful = 0;
        double best = INFINITY;
        for (int64_t s = 0; s < slots; s++) {
            if (allowed ? !allowed[b * slots + s]
                        : !(fabs(area - log_area[s]) <= limits->area && fabs(inertia - log_inertia[s]) <= limits->inertia))
                continue;
            /* Turning and starting elsewhere leave the magnitudes: what they differ by, the outlines differ by. */
            const double *other = slot_magnitudes + HARMONICS * s;
            double least = 0.0;
            for (int k = 0; k < HARMONICS; k++)
                least += (low[k] - other[k]) * (low[k] - other[k]);
            least = sqrt(least) / SAMPLES;
            if (!(least <= slot_limits[s]))
                continue;
            int64_t at = hopeful++;
            for (; at > 0 && bounds[at - 1].least > least; at--)
                bounds[at] = bounds[at - 1];
            bounds[at] = (Bound){least, s};
        }
        /* The most hopeful first: what cannot come near the best any more need not be laid over the blob. */
        for (int64_t h = 0; h < hopeful && bounds[h].least <= limits->worse * best + limits->margin; h++) {
            const int64_t s = bounds[h].slot;
            const int more = peaks(blob_spectra + 2 * SAMPLES * b, blob_energies[b], slot_spectra + 2 * SAMPLES * s,
                                   slot_energies[s], slot_limits[s], roots, all + count);
            for (int i = 0; i < more; i++) {
                all[count + i].slot = (int)s;
                best = fmin(best, all[count + i].distance);
            }
            count += more;
        }
        int64_t kept = 0;
        double closest = INFINITY;
        for (int64_t i = 0; i < count; i++) {
            if (!(all[i].distance <= limits->worse * best + limits->margin))
                continue;
            Peak peak = all[i];
            refine(blob_samples + 2 * SAMPLES * b, slot_samples + 2 * SAMPLES * (ptrdiff_t)peak.slot,
                   slot_normals + 2 * SAMPLES * (ptrdiff_t)peak.slot, limits->floor, &peak);
            closest = fmin(closest, peak.distance);
            all[kept++] = peak;
        }
        int64_t first = 0; /* of the pair's */
        for (int64_t i = 0; i < kept; i++) {
            const Peak *peak = all + i;
            if (all[first].slot != peak->slot)
                first = i;
            int again = !(peak->distance <= limits->worse * closest + limits->close);
            for (int64_t k = first; k < i && !again; k++)
                again = all[k].start >= 0 && same_rotation(peak, all + k, slot_symmetries[peak->slot], limits->same);
            if (again) {
                all[i].start = -1; /* left out: nothing is compared with it */
                continue;
            }
            if (written < room) {
                const double *middle = slot_shapes + SHAPE_FIELDS * (ptrdiff_t)peak->slot;
                const double c = cos(peak->rotation), s = sin(peak->rotation);
                double *row = found + CANDIDATE_FIELDS * written;
                row[CANDIDATE_BLOB] = (double)b;
                row[CANDIDATE_SLOT] = peak->slot;
                row[CANDIDATE_ROTATION] = peak->rotation;
                row[CANDIDATE_X] = shape[SHAPE_X] + peak->x - (c * middle[SHAPE_X] - s * middle[SHAPE_Y]);
                row[CANDIDATE_Y] = shape[SHAPE_Y] + peak->y - (s * middle[SHAPE_X] + c * middle[SHAPE_Y]);
                row[CANDIDATE_DISTANCE] = peak->distance;
            }
            written++;
        }
    }
    return written;
}
