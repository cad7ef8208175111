/* Where are pieces of outlines seen?  edge_projection.py is the reference. */
#include "kernel.h"

#define DEGREE 4
/* A wall narrower than this is not there: top and foot differ by rounding. */
#define LEAST_WALL_PX 1e-3

/* The terms x^i y^j in the order of local_map.TERMS, and their derivatives. */
static void terms(double x, double y, double *value, double *by_x, double *by_y)
{
    double xs[DEGREE + 1] = {1.0}, ys[DEGREE + 1] = {1.0};
    for (int i = 0; i < DEGREE; i++) {
        xs[i + 1] = xs[i] * x;
        ys[i + 1] = ys[i] * y;
    }
    int term = 0;
    for (int total = 0; total <= DEGREE; total++)
        for (int j = 0; j <= total; j++, term++) {
            int i = total - j;
            value[term] = xs[i] * ys[j];
            if (by_x) {
                by_x[term] = i ? i * xs[i - 1] * ys[j] : 0.0;
                by_y[term] = j ? j * xs[i] * ys[j - 1] : 0.0;
            }
        }
}

static inline void dot(const double *coefficients, const double *term, double *u, double *v)
{
    double a = 0.0, b = 0.0;
    for (int i = 0; i < TERMS; i++) {
        a += coefficients[2 * i] * term[i];
        b += coefficients[2 * i + 1] * term[i];
    }
    *u = a;
    *v = b;
}

void slabcell_project(int outlines, const int64_t *starts, const double *pieces, const double *poses,
                      const double *maps, int mirrored, double *lines, double *extras)
{
    for (int o = 0; o < outlines; o++) {
        const double *pose = poses + POSE_FIELDS * (ptrdiff_t)o, *map = maps + MAP_FIELDS * (ptrdiff_t)o;
        const double c = cos(pose[POSE_ROTATION]), s = sin(pose[POSE_ROTATION]), size = map[MAP_SIZE];
        double length = 0.0;
        for (int64_t p = starts[o]; p < starts[o + 1]; p++)
            length += pieces[PIECE_FIELDS * p + PIECE_HALF];
        for (int64_t p = starts[o]; p < starts[o + 1]; p++) {
            const double *piece = pieces + PIECE_FIELDS * p;
            double *line = lines + LINE_FIELDS * p, *extra = extras + EXTRA_FIELDS * p;
            const double dx = piece[PIECE_X] - pose[POSE_PIVOT_X], dy = piece[PIECE_Y] - pose[POSE_PIVOT_Y];
            const double ax = c * dx - s * dy, ay = s * dx + c * dy;
            const double tx = c * piece[PIECE_TX] - s * piece[PIECE_TY], ty = s * piece[PIECE_TX] + c * piece[PIECE_TY];
            const double nx = ty, ny = -tx, half = piece[PIECE_HALF];
            const double x = pose[POSE_X] + ax + pose[POSE_KERF] * nx, y = pose[POSE_Y] + ay + pose[POSE_KERF] * ny;
            const double px = (x - map[MAP_X]) / size, py = (y - map[MAP_Y]) / size;
            const double bulge = piece[PIECE_BEND] * half * half;
            double value[TERMS], by_x[TERMS], by_y[TERMS];
            double u, v, u0, v0, u1, v1, uf, vf, ux, vx, uy, vy;
            terms(px + (-half * tx + bulge * nx) / size, py + (-half * ty + bulge * ny) / size, value, NULL, NULL);
            dot(map + MAP_TOP, value, &u0, &v0);
            terms(px + (half * tx + bulge * nx) / size, py + (half * ty + bulge * ny) / size, value, NULL, NULL);
            dot(map + MAP_TOP, value, &u1, &v1);
            terms(px, py, value, by_x, by_y);
            dot(map + MAP_TOP, value, &u, &v);
            dot(map + MAP_FOOT, value, &uf, &vf);
            dot(map + MAP_TOP, by_x, &ux, &vx);
            dot(map + MAP_TOP, by_y, &uy, &vy);
            const double chord = fmax(hypot(u1 - u0, v1 - v0), 1e-9), side = mirrored ? -1.0 : 1.0;
            const double nu = side * (v1 - v0) / chord, nv = -side * (u1 - u0) / chord;
            const double sag = nu * (0.5 * (u0 + u1) - u) + nv * (0.5 * (v0 + v1) - v);
            line[LINE_U] = u;
            line[LINE_V] = v;
            line[LINE_NORMAL_U] = nu;
            line[LINE_NORMAL_V] = nv;
            line[LINE_HALF] = 0.5 * chord;
            line[LINE_BEND] = sag / (0.25 * chord * chord);
            const double wall = nu * (uf - u) + nv * (vf - v);
            line[LINE_WALL] = wall > LEAST_WALL_PX ? wall : 0.0;
            extra[ROW_X] = nx;
            extra[ROW_Y] = ny;
            extra[ROW_TURN] = ny * ax - nx * ay;
            extra[ROW_KERF] = 1.0;
            extra[PX_PER_MM] = (nu * (nx * ux + ny * uy) + nv * (nx * vx + ny * vy)) / size;
            extra[SHARE] = half / fmax(length, 1e-9);
            extra[TABLE_X] = x;
            extra[TABLE_Y] = y;
        }
    }
}
