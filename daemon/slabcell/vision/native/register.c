/* How exactly does each candidate lie?  registration.py, picture_model.py and look.py are the references. */
#include "kernel.h"

#define PROBED 8
#define LOOKS 3
#define MAX_PROBES 1024
#define REDISTRIBUTIONS 5

typedef struct {
    double scale;              /* mm per pixel */
    double mirrored, rough;     /* rough: candidates lie there to some pixels only, or walls are seen */
    double floor_px;           /* no piece is trusted better than this */
    double prior;              /* 1/mm^2: what nothing measures is held where it is */
    double support_mm;         /* a piece farther off does not support the outline */
    double missing_mm;         /* a missing piece counts as if it were this far off */
    double again_mm;           /* another look is taken after a motion of more than this */
    double wall_floor_mm;
    double margin_mm;          /* how far beyond an outline its map holds */
    double sigma, first_reach, reach, wall_ratio, wall_ratio_sigma, first_wall_ratio_sigma; /* before the picture is asked */
    double least_wall_sigma, most_wall_sigma, light_sigma;
    double noise_share, least_noise, least_slope_sigma, least_slope_share;
    double near_reach, reach_blurs; /* once blur and slopes are known */
} Settings;

/* Outlines that candidates may be: pieces of all, one outline after the other, whole, few and as probes. */
typedef struct {
    const int64_t *starts[3];
    const double *pieces[3];
    const double *pivots; /* (outlines, 2) mm */
} Outlines;
enum { WHOLE, FEW, PROBES };

typedef struct {
    const void *image;
    ptrdiff_t stride;
    int width, height, wide; /* wide: 16 bits */
    const double *table;
    const Settings *how;
} Picture;

enum { COVERAGE, RESIDUAL, EVIDENCE, SUPPORT_FIELDS };
enum {
    FOUND_ROTATION, FOUND_X, FOUND_Y, FOUND_KERF, FOUND_RESIDUAL, FOUND_COVERAGE, FOUND_EVIDENCE, FOUND_COVARIANCE,
    FOUND_FIELDS = FOUND_COVARIANCE + 9
};

/* Memory for one look, over pieces and over outlines. */
typedef struct {
    int64_t *starts;
    double *pieces, *poses, *maps, *lines, *extras, *results, *measured, *remaining;
    double *changes, *covariances, *spreads, *support;
} Room;

static void measure(const Picture *p, int64_t pieces, const double *lines, const Model *model, double *results)
{
    if (p->wide)
        slabcell_measure_edges_u16(p->image, p->stride, p->width, p->height, (int)pieces, lines, model, p->table, results);
    else
        slabcell_measure_edges_u8(p->image, p->stride, p->width, p->height, (int)pieces, lines, model, p->table, results);
}

static void judge(int outlines, const Room *room, const Settings *how)
{
    const double missing = how->missing_mm * how->missing_mm;
    for (int o = 0; o < outlines; o++) {
        double covered = 0.0, weight = 0.0, squares = 0.0, evidence = 0.0;
        for (int64_t i = room->starts[o]; i < room->starts[o + 1]; i++) {
            const double share = room->extras[EXTRA_FIELDS * i + SHARE], left = room->remaining[i];
            const int valid = room->measured[3 * i + 2] > 0.5;
            if (valid) {
                weight += share;
                squares += share * left * left;
                if (fabs(left) <= how->support_mm)
                    covered += share;
            }
            evidence += share * (valid ? fmin(left * left, missing) : missing);
        }
        double *support = room->support + SUPPORT_FIELDS * (ptrdiff_t)o;
        support[COVERAGE] = covered;
        support[RESIDUAL] = sqrt(squares / fmax(weight, 1e-9));
        support[EVIDENCE] = sqrt(evidence);
    }
}

/* Gathers the pieces of candidates `which` (n of them, or all if null) and takes one look at them. */
static void look(const Picture *p, const Outlines *outlines, int kind, int n, const int64_t *which, const int64_t *slots,
                 const double *poses, const double *maps, const Model *model, const Room *room)
{
    room->starts[0] = 0;
    for (int i = 0; i < n; i++) {
        const int64_t c = which ? which[i] : i, slot = slots[c];
        const int64_t first = outlines->starts[kind][slot], count = outlines->starts[kind][slot + 1] - first;
        memcpy(room->pieces + PIECE_FIELDS * room->starts[i], outlines->pieces[kind] + PIECE_FIELDS * first,
               (size_t)(PIECE_FIELDS * count) * sizeof(double));
        room->starts[i + 1] = room->starts[i] + count;
        memcpy(room->poses + POSE_FIELDS * i, poses + POSE_FIELDS * c, POSE_FIELDS * sizeof(double));
        memcpy(room->maps + MAP_FIELDS * (ptrdiff_t)i, maps + MAP_FIELDS * c, (size_t)MAP_FIELDS * sizeof(double));
    }
    const int64_t pieces = room->starts[n];
    slabcell_project(n, room->starts, room->pieces, room->poses, room->maps, p->how->mirrored > 0.5, room->lines,
                     room->extras);
    measure(p, pieces, room->lines, model, room->results);
    for (int64_t i = 0; i < pieces; i++) {
        const double *result = room->results + RESULT_FIELDS * i, per_mm = room->extras[EXTRA_FIELDS * i + PX_PER_MM];
        room->measured[3 * i] = result[SHIFT] / per_mm;
        room->measured[3 * i + 1] = sqrt(result[SIGMA] * result[SIGMA] + p->how->floor_px * p->how->floor_px) / per_mm;
        room->measured[3 * i + 2] = result[VALID];
    }
    slabcell_solve(n, room->starts, room->extras, room->measured, p->how->prior, room->changes, room->covariances,
                   room->spreads, room->remaining);
    judge(n, room, p->how);
}

static void move(double *pose, const double *change)
{
    pose[POSE_X] += change[0];
    pose[POSE_Y] += change[1];
    pose[POSE_ROTATION] += change[2];
    pose[POSE_KERF] += change[3];
}

static int solve3(double a[3][3], double b[3])
{
    for (int i = 0; i < 3; i++) {
        if (!(a[i][i] > 0.0))
            return 0;
        for (int k = i + 1; k < 3; k++) {
            const double factor = a[k][i] / a[i][i];
            for (int j = i; j < 3; j++)
                a[k][j] -= factor * a[i][j];
            b[k] -= factor * b[i];
        }
    }
    for (int i = 2; i >= 0; i--) {
        for (int j = i + 1; j < 3; j++)
            b[i] -= a[i][j] * b[j];
        b[i] /= a[i][i];
    }
    return 1;
}

/* The grey of walls over that of upper faces, linear in their normals, by robust least squares. */
static void judge_walls(int64_t pieces, const Room *room, const Settings *how, Model *model)
{
    double ratios[MAX_PROBES], normals[MAX_PROBES][3], weight[MAX_PROBES], away[MAX_PROBES];
    int n = 0;
    for (int64_t i = 0; i < pieces && n < MAX_PROBES; i++) {
        const double *result = room->results + RESULT_FIELDS * i, *line = room->lines + LINE_FIELDS * i;
        if (!(result[VALID] > 0.5) || !(result[INSIDE] > 1.0) || !(line[LINE_WALL] > 1.5))
            continue;
        ratios[n] = fmin(fmax(result[WALL_LEVEL] / result[INSIDE], 0.0), 1.5);
        normals[n][0] = 1.0;
        normals[n][1] = line[LINE_NORMAL_U];
        normals[n][2] = line[LINE_NORMAL_V];
        weight[n++] = 1.0;
    }
    if (n < 6)
        return;
    const double prior = 0.05 / how->light_sigma * (0.05 / how->light_sigma);
    for (int step = 0; step < REDISTRIBUTIONS; step++) {
        double a[3][3] = {{1e-9, 0.0, 0.0}, {0.0, prior + 1e-9, 0.0}, {0.0, 0.0, prior + 1e-9}}, b[3] = {0};
        for (int i = 0; i < n; i++)
            for (int r = 0; r < 3; r++) {
                b[r] += weight[i] * normals[i][r] * ratios[i];
                for (int c = 0; c < 3; c++)
                    a[r][c] += weight[i] * normals[i][r] * normals[i][c];
            }
        if (!solve3(a, b))
            return;
        double sorted[MAX_PROBES];
        for (int i = 0; i < n; i++)
            sorted[i] = away[i] = fabs(ratios[i] - (b[0] + b[1] * normals[i][1] + b[2] * normals[i][2]));
        const double middle = 1.4826 * slabcell_nth(sorted, n, n / 2);
        const double scatter = fmin(fmax(middle, how->least_wall_sigma), how->most_wall_sigma);
        for (int i = 0; i < n; i++)
            weight[i] = 1.0 / (1.0 + away[i] / (2.0 * scatter) * (away[i] / (2.0 * scatter)));
        model->wall_ratio = b[0];
        model->wall_light_u = b[1];
        model->wall_light_v = b[2];
        model->wall_ratio_sigma = scatter;
    }
}

/* The mean slope on one side of edges; `weight` is one over the variance of the true ones: the spread of those that were
 * measured less the measurement's. */
static double know_slope(int n, double *slopes, double *variances, const Settings *how, double *weight)
{
    const double mean = slabcell_nth(slopes, n, n / 2), least = how->least_slope_sigma * how->least_slope_sigma;
    for (int i = 0; i < n; i++)
        slopes[i] = fabs(slopes[i] - mean);
    const double spread = 1.4826 * slabcell_nth(slopes, n, n / 2), measured = spread * spread;
    *weight = 1.0 / fmax(fmax(measured - slabcell_nth(variances, n, n / 2), how->least_slope_share * measured), least);
    return mean;
}

/* What the edges of this picture are like, asked at some of the candidates; returns how far they lie outside. */
static double ask(const Picture *p, const Outlines *outlines, int candidates, const int64_t *slots, const double *poses,
                  const double *maps, const Room *room, Model *model)
{
    const Settings *how = p->how;
    int64_t which[PROBED];
    int asked = 0;
    for (int i = 0; i < PROBED; i++) {
        const int64_t c = (int64_t)((candidates - 1) * (i / (PROBED - 1.0)));
        if (!asked || which[asked - 1] != c)
            which[asked++] = c;
    }
    const Model question = {.sigma = how->sigma, .reach = how->reach, .wall_ratio = how->wall_ratio,
                            .wall_ratio_sigma = how->first_wall_ratio_sigma, .noise = 1.0, .grain_reach = 3.0,
                            .least_scatter = 0.25, .fit_blur = 1.0};
    look(p, outlines, how->rough > 0.5 ? FEW : PROBES, asked, which, slots, poses, maps, &question, room);
    const int64_t pieces = room->starts[asked];
    double values[RESULT_FIELDS][MAX_PROBES];
    int n = 0;
    /* From edges without a wall, where there are enough. */
    for (int plain = 1; plain >= 0; plain--) {
        n = 0;
        for (int64_t i = 0; i < pieces && n < MAX_PROBES; i++) {
            const double *result = room->results + RESULT_FIELDS * i;
            if (!(result[VALID] > 0.5) || !(fabs(result[INSIDE] - result[OUTSIDE]) > 10.0)
                || (plain && !(room->lines[LINE_FIELDS * i + LINE_WALL] < 0.5)))
                continue;
            for (int field = 0; field < RESULT_FIELDS; field++)
                values[field][n] = result[field];
            values[SHIFT][n++] /= room->extras[EXTRA_FIELDS * i + PX_PER_MM];
        }
        if (n >= 6)
            break;
    }
    *model = (Model){.sigma = how->sigma, .reach = how->reach, .wall_ratio = how->wall_ratio,
                     .wall_ratio_sigma = how->wall_ratio_sigma, .noise = 1.0, .grain_reach = 3.0, .least_scatter = 1.0,
                     .near = 1.0};
    judge_walls(pieces, room, how, model);
    if (n < 4)
        return 0.0;
    const double inside = fmax(slabcell_nth(values[SCATTER_INSIDE], n, n / 2), how->least_noise);
    const double outside = fmax(slabcell_nth(values[SCATTER_OUTSIDE], n, n / 2), how->least_noise);
    model->noise = how->noise_share * fmin(inside, outside);
    model->grain_inside = inside - model->noise;
    model->grain_outside = outside - model->noise;
    model->sigma = slabcell_nth(values[BLUR], n, n / 2);
    model->reach = fmin(fmax(how->near_reach, how->reach_blurs * model->sigma), how->reach);
    model->slope_inside = know_slope(n, values[SLOPE_INSIDE], values[SLOPE_INSIDE_VARIANCE], how,
                                     &model->slope_inside_weight);
    model->slope_outside = know_slope(n, values[SLOPE_OUTSIDE], values[SLOPE_OUTSIDE_VARIANCE], how,
                                      &model->slope_outside_weight);
    return slabcell_nth(values[SHIFT], n, n / 2);
}

/* `candidates` (count, CANDIDATE_FIELDS): what blobs may be.  `given`, `few`, `probes`: the outlines, whole and in part,
 * with their pivots and how far each reaches from it (mm).  Either there are `maps` for these candidates, or they are made
 * from the `table`, the nodes and the inverse as in maps.c.  `scratch` has room for candidates and pieces as kernel.py
 * says.  Writes FOUND_FIELDS of each.  Returns 0 where the table does not reach so far. */
int slabcell_register(const void *image, ptrdiff_t stride, int width, int height, int wide, const double *normal,
                      const Settings *how, const int64_t *whole_starts, const double *whole, const int64_t *few_starts,
                      const double *few, const int64_t *probe_starts, const double *probes, const double *pivots,
                      const double *reaches, const Forward *table, int nodes, const double *node, const double *inverse,
                      const double *maps, int candidates, const double *given, int64_t pieces, int64_t *starts,
                      double *scratch, double *found)
{
    const Picture picture = {image, stride, width, height, wide, normal, how};
    const Outlines outlines = {{whole_starts, few_starts, probe_starts}, {whole, few, probes}, pivots};
    double *next = scratch;
#define TAKE(count) (next += (count), next - (count))
    double *poses = TAKE(POSE_FIELDS * candidates), *covariances = TAKE(16 * candidates), *spreads = TAKE(candidates);
    double *support = TAKE(SUPPORT_FIELDS * candidates), *sorted = TAKE(candidates), *own = TAKE(MAP_FIELDS * candidates);
    const Room room = {starts, TAKE(PIECE_FIELDS * pieces), TAKE(POSE_FIELDS * candidates), TAKE(MAP_FIELDS * candidates),
                       TAKE(LINE_FIELDS * pieces), TAKE(EXTRA_FIELDS * pieces), TAKE(RESULT_FIELDS * pieces),
                       TAKE(3 * pieces), TAKE(pieces), TAKE(4 * candidates), TAKE(16 * candidates), TAKE(candidates),
                       TAKE(SUPPORT_FIELDS * candidates)};
#undef TAKE
    int64_t *again = starts + candidates + 1, *slots = again + candidates;
    for (int c = 0; c < candidates; c++) {
        const double *candidate = given + CANDIDATE_FIELDS * (ptrdiff_t)c;
        slots[c] = (int64_t)candidate[CANDIDATE_SLOT];
        const double *pivot = pivots + 2 * slots[c], rotation = candidate[CANDIDATE_ROTATION];
        const double cosine = cos(rotation), sine = sin(rotation);
        double *pose = poses + POSE_FIELDS * (ptrdiff_t)c;
        pose[POSE_ROTATION] = rotation;
        pose[POSE_X] = cosine * pivot[0] - sine * pivot[1] + candidate[CANDIDATE_X];
        pose[POSE_Y] = sine * pivot[0] + cosine * pivot[1] + candidate[CANDIDATE_Y];
        pose[POSE_PIVOT_X] = pivot[0];
        pose[POSE_PIVOT_Y] = pivot[1];
        pose[POSE_KERF] = 0.0;
        again[c] = c;
        const double size = reaches[slots[c]] + how->margin_mm;
        if (!maps && !slabcell_local_maps(table, nodes, node, inverse, 1, pose + POSE_X, &size, own + MAP_FIELDS * (ptrdiff_t)c))
            return 0;
    }
    if (!maps)
        maps = own;
    if (how->rough > 0.5) {
        const Model first = {.sigma = how->sigma, .reach = how->first_reach, .wall_ratio = how->wall_ratio,
                             .wall_ratio_sigma = how->first_wall_ratio_sigma, .noise = 1.0, .grain_reach = 3.0,
                             .least_scatter = 0.25};
        look(&picture, &outlines, FEW, candidates, NULL, slots, poses, maps, &first, &room);
        for (int c = 0; c < candidates; c++)
            move(poses + POSE_FIELDS * (ptrdiff_t)c, room.changes + 4 * (ptrdiff_t)c);
    }
    Model model;
    const double offset = ask(&picture, &outlines, candidates, slots, poses, maps, &room, &model);
    for (int c = 0; c < candidates; c++)
        poses[POSE_FIELDS * (ptrdiff_t)c + POSE_KERF] += offset;
    /* Another look only at what moved: a pose is exact when it is measured where it is. */
    int left = candidates;
    for (int round = 0; round < LOOKS && left; round++) {
        look(&picture, &outlines, WHOLE, left, again, slots, poses, maps, &model, &room);
        int moved = 0;
        for (int i = 0; i < left; i++) {
            const int64_t c = again[i];
            const double *change = room.changes + 4 * (ptrdiff_t)i;
            move(poses + POSE_FIELDS * c, change);
            memcpy(covariances + 16 * c, room.covariances + 16 * (ptrdiff_t)i, 16 * sizeof(double));
            memcpy(support + SUPPORT_FIELDS * c, room.support + SUPPORT_FIELDS * (ptrdiff_t)i,
                   SUPPORT_FIELDS * sizeof(double));
            spreads[c] = room.spreads[i];
            const double turned = fabs(change[2]) * reaches[slots[c]];
            if (fmax(fmax(fabs(change[0]), fabs(change[1])), turned) > how->again_mm)
                again[moved++] = c;
        }
        left = moved;
    }
    int good = 0;
    for (int c = 0; c < candidates; c++)
        if (support[SUPPORT_FIELDS * c + COVERAGE] > 0.9 && spreads[c] > 0.0)
            sorted[good++] = spreads[c];
    const double usual = good ? slabcell_nth(sorted, good, good / 2) : 1.0;
    const double wall_floor = how->rough > 0.5 ? how->wall_floor_mm * how->wall_floor_mm : 0.0;
    for (int c = 0; c < candidates; c++) {
        const double *pose = poses + POSE_FIELDS * (ptrdiff_t)c, *judged = support + SUPPORT_FIELDS * (ptrdiff_t)c;
        const double cosine = cos(pose[POSE_ROTATION]), sine = sin(pose[POSE_ROTATION]);
        const double scatter = fmax(spreads[c], usual);
        double *row = found + FOUND_FIELDS * (ptrdiff_t)c;
        row[FOUND_ROTATION] = pose[POSE_ROTATION];
        row[FOUND_X] = pose[POSE_X] - cosine * pose[POSE_PIVOT_X] + sine * pose[POSE_PIVOT_Y];
        row[FOUND_Y] = pose[POSE_Y] - sine * pose[POSE_PIVOT_X] - cosine * pose[POSE_PIVOT_Y];
        row[FOUND_KERF] = pose[POSE_KERF];
        row[FOUND_RESIDUAL] = judged[RESIDUAL];
        row[FOUND_COVERAGE] = judged[COVERAGE];
        row[FOUND_EVIDENCE] = judged[EVIDENCE];
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++)
                row[FOUND_COVARIANCE + 3 * i + j] =
                    covariances[16 * (ptrdiff_t)c + 4 * i + j] * scatter * scatter + (i == j && i < 2 ? wall_floor : 0.0);
    }
    return 1;
}
