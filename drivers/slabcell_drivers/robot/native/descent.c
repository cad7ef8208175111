/* The axes of the arm at the lower end of ways straight down, many in one call.  Plain C, no Python, no state.
 *
 * The reference is in Python: cell/descent.py for the flange, arm_solve.py and arm.py for the axes; the names are those
 * used there.  What cannot be reached here, Python is asked about: it knows why, and says so.
 */
#include <math.h>
#include <string.h>

#define DESCENT_VERSION 1
#define ANY (-1)

#define WRIST_SINGULAR_SINE 1e-10
#define SHOULDER_SINGULAR_MM 1e-7
#define STRETCHED_TOLERANCE_MM 1e-7
#define ZERO_DEG 1e-9
#define HALF_TURN_DEG (180.0 - 1e-6)
#define LIMIT_TOLERANCE_DEG 1e-7

static const double PI = 3.14159265358979323846;

typedef struct {
    double base_height, shoulder, upper_arm, forearm_x, forearm_z, flange; /* mm */
    double min_deg[6], max_deg[6], speed_deg_s[6];
} Arm;

typedef struct {
    double flange_in_tool[4][3]; /* by columns, the last is the position */
    double base[3][4];           /* by rows */
    double up[3];                /* from a pose to the one above it, in the root frame */
} Path;

typedef struct {
    double x, y, a_deg, height; /* of the tool's tip in the base */
} Down;

static double radians(double degrees) { return degrees * (PI / 180.0); }

/* In (-180, 180]. */
static double degrees(double angle) {
    double turned = fmod(180.0 - angle * (180.0 / PI), 360.0);
    double found = turned < 0.0 ? -turned - 180.0 : 180.0 - turned;
    return fabs(found) < ZERO_DEG ? 0.0 : found;
}

/* Where the flange is when the tool stands at a pose, unturned. */
static void flange_at(const Path *path, const Down *down, double position[3], double rotation[3][3]) {
    double c = cos(radians(down->a_deg)), s = sin(radians(down->a_deg));
    double column[4][3];
    for (int i = 0; i < 4; i++) {
        const double *f = path->flange_in_tool[i];
        column[i][0] = c * f[0] + s * f[1];
        column[i][1] = s * f[0] - c * f[1];
        column[i][2] = -f[2];
    }
    column[3][0] += down->x;
    column[3][1] += down->y;
    column[3][2] += down->height;
    for (int row = 0; row < 3; row++) {
        const double *b = path->base[row];
        for (int i = 0; i < 3; i++)
            rotation[row][i] = b[0] * column[i][0] + b[1] * column[i][1] + b[2] * column[i][2];
        position[row] = b[0] * column[3][0] + b[1] * column[3][1] + b[2] * column[3][2] + b[3];
    }
}

/* A2 and A3 that bring the wrist to x, z of the A2 axis, with the elbow on one side. */
static int main_axes(const Arm *arm, double x, double z, int elbow, double *a2, double *a3) {
    double upper = arm->upper_arm, fore = hypot(arm->forearm_x, arm->forearm_z);
    double stretched = atan2(arm->forearm_z, arm->forearm_x), distance = hypot(x, z);
    double beyond = upper + fore - distance, before = distance - fabs(upper - fore);
    if (!(beyond >= -STRETCHED_TOLERANCE_MM && before >= -STRETCHED_TOLERANCE_MM))
        return 0;
    double far = fmax(beyond, 0.0) * (upper + fore + distance);
    double close = fmax(before, 0.0) * (distance + fabs(upper - fore));
    double bend = 2.0 * atan2(sqrt(far), sqrt(close));
    double lead = atan2(fore * sin(bend), upper + fore * cos(bend)), direction = atan2(-z, x);
    *a2 = elbow ? direction - lead : direction + lead;
    *a3 = elbow ? stretched + bend : stretched - bend;
    return 1;
}

/* A4, A5, A6 that give the flange this rotation; at the singularity there is no flipped wrist. */
static int wrist_axes(const double r[3][3], double a1, double a23, int flipped, double a4_if_singular, double *a4,
                      double *a5, double *a6) {
    double c1 = cos(a1), s1 = -sin(a1), c23 = cos(a23), s23 = sin(a23);
    double m[3][3];
    for (int i = 0; i < 3; i++) {
        double x = r[0][2 - i], y = r[1][2 - i], z = r[2][2 - i], plane = c1 * x + s1 * y;
        m[0][i] = c23 * plane - s23 * z;
        m[1][i] = c1 * y - s1 * x;
        m[2][i] = s23 * plane + c23 * z;
    }
    double sine = hypot(m[1][0], m[2][0]);
    if (sine < WRIST_SINGULAR_SINE && m[0][0] > 0.0) {
        *a4 = a4_if_singular;
        *a5 = 0.0;
        *a6 = -atan2(m[2][1], m[1][1]) - a4_if_singular;
        return !flipped;
    }
    double sign = flipped ? -1.0 : 1.0;
    *a4 = -atan2(sign * m[1][0], -sign * m[2][0]);
    *a5 = sign * atan2(sine, m[0][0]);
    *a6 = -atan2(sign * m[0][1], -sign * m[0][2]);
    return 1;
}

/* The whole turns that bring an axis nearest to a target within its limits. */
static int nearest(double angle, double target, double low, double high, double *chosen) {
    if (low <= angle && angle <= high && fabs(angle - target) < HALF_TURN_DEG) {
        *chosen = angle;
        return 1;
    }
    low -= LIMIT_TOLERANCE_DEG;
    high += LIMIT_TOLERANCE_DEG;
    int found = 0;
    for (double turned = angle - 360.0 * floor((angle - low) / 360.0); turned <= high; turned += 360.0) {
        if (!found || fabs(turned - target) < fabs(*chosen - target))
            *chosen = turned;
        found = 1;
    }
    return found;
}

static int inverse(const Arm *arm, const double position[3], const double r[3][3], int status, const double near[6],
                   double axes[6]) {
    double wx = position[0] - arm->flange * r[0][2], wy = position[1] - arm->flange * r[1][2];
    double wz = position[2] - arm->flange * r[2][2] - arm->base_height;
    double radius = hypot(wx, wy), a[6];
    double front = radius > SHOULDER_SINGULAR_MM ? -atan2(wy, wx) : radians(near[0]);
    int behind = status & 1;
    a[0] = behind ? front + PI : front;
    if (!main_axes(arm, (behind ? -radius : radius) - arm->shoulder, wz, status & 2, &a[1], &a[2]))
        return 0;
    if (!wrist_axes(r, a[0], a[1] + a[2], status & 4, radians(near[3]), &a[3], &a[4], &a[5]))
        return 0;
    for (int i = 0; i < 6; i++)
        if (!nearest(degrees(a[i]), near[i], arm->min_deg[i], arm->max_deg[i], &axes[i]))
            return 0;
    return 1;
}

/* The axes at a pose, got straight down to from the one above in one configuration. */
static int descend(const Arm *arm, const double above[3], const double at[3], const double r[3][3], int status,
                   double over[6], double axes[6]) {
    static const double rest[6] = {0.0};
    return inverse(arm, above, r, status, rest, over) && inverse(arm, at, r, status, over, axes);
}

/* The same in the configuration whose axes above are quickest to reach from zero; ANY if there is none.  The order of
 * the configurations is that of arm_solve.solve: of equals the first is taken. */
static int descend_quickest(const Arm *arm, const double above[3], const double at[3], const double r[3][3],
                            double axes[6]) {
    static const int order[8] = {2, 6, 0, 4, 3, 7, 1, 5};
    double over[6], found[6], best_s = INFINITY;
    int best = ANY;
    for (int i = 0; i < 8; i++) {
        if (!descend(arm, above, at, r, order[i], over, found))
            continue;
        double longest_s = 0.0;
        for (int k = 0; k < 6; k++)
            longest_s = fmax(longest_s, fabs(over[k]) / arm->speed_deg_s[k]);
        if (longest_s < best_s) {
            best_s = longest_s;
            best = order[i];
            memcpy(axes, found, sizeof found);
        }
    }
    return best;
}

int slabcell_descent_version(void) { return DESCENT_VERSION; }

/* For `n` poses: the axes at each in the configuration `status`, where the arm gets straight down to it in that.  With
 * ANY, it is the quickest of the first pose that is reached at all.  Returns the status. */
int slabcell_descend(const Arm *arm, const Path *path, int status, int n, const Down *downs, double (*axes)[6],
                     signed char *reached) {
    for (int i = 0; i < n; i++) {
        double at[3], above[3], rotation[3][3], over[6];
        flange_at(path, &downs[i], at, rotation);
        for (int k = 0; k < 3; k++)
            above[k] = at[k] + path->up[k];
        if (status == ANY) {
            status = descend_quickest(arm, above, at, rotation, axes[i]);
            reached[i] = status != ANY;
        } else {
            reached[i] = (signed char)descend(arm, above, at, rotation, status, over, axes[i]);
        }
    }
    return status;
}
