/* Included by profile.c for each PIXEL type: sorts the pixels near a piece of edge into bins, and fits their profile. */

static void NAME(measure_one)(const PIXEL *image, ptrdiff_t stride, int width, int height, const double *line,
                              const Model *model, const double *table, double *result)
{
    const double reach = model->reach, half = line[LINE_HALF], bend = line[LINE_BEND], wall = line[LINE_WALL];
    const double outer = wall > WIDE_WALL_PX ? WIDE_WALL_PX - 2.0 : wall + reach;
    memset(result, 0, RESULT_FIELDS * sizeof(double));
    if (!(wall >= 0.0) || !(outer < 1e3) || !(half > 0.0) || !(half <= MAX_HALF_PX) || !(fabs(bend) < 1.0))
        return;
    /* Which pixels belong to the piece is said by its chord; the bins have room for how far it bends away from that. */
    const double sag = bend * half * half;
    if (!(fabs(sag) <= MAX_SAG_PX))
        return;
    const double lowest = ceil(outer) + MAX_SAG_PX + 1.0;
    const int bins = (int)ceil((lowest + reach + MAX_SAG_PX + 1.0) * BINS_PER_PX) + 1;
    if (bins > MAX_BINS)
        return;
    /* Of each bin one number: how many pixels, the sum of their levels, and the sum of their places among the bins. */
    uint64_t sums[MAX_BINS];
    memset(sums, 0, (size_t)bins * sizeof(uint64_t));
    /* Scan along the axis that the edge follows more closely. */
    const int along_u = fabs(line[LINE_NORMAL_V]) >= fabs(line[LINE_NORMAL_U]);
    const double t_major = along_u ? -line[LINE_NORMAL_V] : line[LINE_NORMAL_U];
    const double t_minor = along_u ? line[LINE_NORMAL_U] : -line[LINE_NORMAL_V];
    const double n_major = along_u ? line[LINE_NORMAL_U] : line[LINE_NORMAL_V];
    const double n_minor = along_u ? line[LINE_NORMAL_V] : line[LINE_NORMAL_U];
    const double mid_major = along_u ? line[LINE_U] : line[LINE_V], mid_minor = along_u ? line[LINE_V] : line[LINE_U];
    const int size_major = along_u ? width : height, size_minor = along_u ? height : width;
    const ptrdiff_t next = along_u ? stride : 1, next_major = along_u ? 1 : stride;
    const double extent = half * fabs(t_major) + fmax(outer, reach) * fabs(n_major);
    const double norm = n_major * n_major + n_minor * n_minor;
    if (!(fabs(mid_major) < 1e6) || !(fabs(mid_minor) < 1e6) || !(fabs(norm - 1.0) < 1e-6))
        return;
    int first = (int)ceil(mid_major - extent), last = (int)floor(mid_major + extent);
    first = first < 0 ? 0 : first;
    last = last > size_major - 1 ? size_major - 1 : last;
    /* A scan line crosses the strip from `low` to `high`, and the piece's length where that is aslant to it. */
    const double per_n = 1.0 / n_minor, side = n_minor > 0.0 ? 1.0 : -1.0;
    const int aslant = fabs(t_minor) > 1e-12;
    const double per_t = aslant ? 1.0 / t_minor : 0.0, length = aslant ? half * fabs(per_t) : FAR;
    if (!aslant) {
        first = first > (int)ceil(mid_major - half) ? first : (int)ceil(mid_major - half);
        last = last < (int)floor(mid_major + half) ? last : (int)floor(mid_major + half);
    }
    const int lines = last - first + 1;
    if (lines < 1 || lines > MAX_LINES)
        return;
    const double before = (side > 0.0 ? reach : outer) * fabs(per_n), beyond = (side > 0.0 ? outer : reach) * fabs(per_n);
    const double along_n = n_major * per_n, along_t = t_major * per_t, offset = first - mid_major, end_minor = size_minor - 1;
    int32_t begins[MAX_LINES], ends[MAX_LINES], places[MAX_LINES], steps[MAX_LINES];
    for (int k = 0; k < lines; k++) {
        const double da = k + offset, centre = -da * along_n, middle = -da * along_t;
        double low = centre - before, high = centre + beyond;
        low = low > middle - length ? low : middle - length;
        high = high < middle + length ? high : middle + length;
        low = low + mid_minor > 0.0 ? low + mid_minor : 0.0;
        high = high + mid_minor < end_minor ? high + mid_minor : end_minor;
        low = low < size_minor ? low : size_minor;
        high = high > -1.0 ? high : -1.0;
        const double begin = ceil(low);
        /* The place is quadratic along the line: two additions of fixed point numbers lead from pixel to pixel. */
        const double db = begin - mid_minor, t = da * t_major + db * t_minor;
        double place = (lowest - da * n_major - db * n_minor + bend * t * t) * BINS_PER_PX;
        place = place > 0.0 ? place : 0.0;
        place = place < bins ? place : bins;
        begins[k] = (int32_t)begin;
        ends[k] = (int32_t)floor(high);
        places[k] = (int32_t)(place * FIXED);
        steps[k] = (int32_t)((bend * t_minor * (2.0 * t + t_minor) - n_minor) * BINS_PER_PX * FIXED);
    }
    const int32_t bending = (int32_t)(2.0 * bend * t_minor * t_minor * BINS_PER_PX * FIXED);
    for (int k = 0; k < lines; k++) {
        const PIXEL *pixel = image + (first + k) * next_major + begins[k] * next;
        int32_t at = places[k], change = steps[k];
        for (int b = begins[k]; b <= ends[k]; b++, pixel += next) {
            sums[at >> FIXED_BITS] += 1 + ((uint64_t)*pixel << COUNT_BITS)
                                      + ((uint64_t)(at >> (FIXED_BITS - PLACE_BITS)) << (COUNT_BITS + LEVEL_BITS));
            at += change;
            change += bending;
        }
    }
    int low_bin = 0, high_bin = bins - 1;
    while (low_bin < bins && !sums[low_bin])
        low_bin++;
    while (high_bin > low_bin && !sums[high_bin])
        high_bin--;
    const int n = high_bin - low_bin + 1;
    if (n <= COLUMNS)
        return;
    /* An integer below 2^52 is a double's mantissa: with the right exponent beside it, 2^52 too much. */
    union {
        uint64_t bits[MAX_BINS];
        double value[MAX_BINS];
    } numbers, levels, depths;
    for (int i = 0; i < n; i++) {
        const uint64_t sum = sums[low_bin + i];
        numbers.bits[i] = (sum & (((uint64_t)1 << COUNT_BITS) - 1)) | MANTISSA;
        levels.bits[i] = (sum >> COUNT_BITS & (((uint64_t)1 << LEVEL_BITS) - 1)) | MANTISSA;
        depths.bits[i] = sum >> (COUNT_BITS + LEVEL_BITS) | MANTISSA;
    }
    double filled = 0.0;
    for (int i = 0; i < n; i++) {
        const double number = numbers.value[i] - TWO_52, share = 1.0 / (number > 1.0 ? number : 1.0);
        /* What was cut off below the last bit is half of it on the average.  An empty bin lies in its middle. */
        const double place = ((depths.value[i] - TWO_52) * share + 0.5) * (1.0 / ((int64_t)1 << PLACE_BITS));
        const double empty = low_bin + i + 0.5;
        depths.value[i] = (number > 0.0 ? place : empty) * (1.0 / BINS_PER_PX) - lowest;
        levels.value[i] = (levels.value[i] - TWO_52) * share;
        numbers.value[i] = number;
        filled += number > 0.0 ? 1.0 : 0.0;
    }
    const double lit = model->wall_ratio + model->wall_light_u * line[LINE_NORMAL_U] + model->wall_light_v * line[LINE_NORMAL_V];
    if (filled > COLUMNS)
        fit(n, filled, numbers.value, depths.value, levels.value, wall, fmin(fmax(lit, 0.0), 1.5), model, table, result);
}

/* Asks for the pixels around a piece of edge. */
static void NAME(prefetch)(const PIXEL *image, ptrdiff_t stride, int width, int height, const double *line, double reach)
{
    const double half = line[LINE_HALF], nu = fabs(line[LINE_NORMAL_U]), nv = fabs(line[LINE_NORMAL_V]);
    const double outer = fmin(line[LINE_WALL], WIDE_WALL_PX) + reach;
    const double wide = half * nv + outer * nu, high = half * nu + outer * nv, u = line[LINE_U], v = line[LINE_V];
    if (!(wide < 1e3) || !(high < 1e3) || !(u > -1e3) || !(u < 1e6) || !(v > -1e3) || !(v < 1e6))
        return;
    const int left = u > wide ? (int)(u - wide) : 0, top = v > high ? (int)(v - high) : 0;
    const int right = u + wide < width - 1 ? (int)(u + wide) : width - 1;
    const int bottom = v + high < height - 1 ? (int)(v + high) : height - 1;
    for (int row = top; row <= bottom; row++)
        for (int column = left; column <= right; column += 64 / (int)sizeof(PIXEL))
            slabcell_prefetch(image + row * stride + column);
}

void NAME(slabcell_measure_edges)(const PIXEL *image, ptrdiff_t stride, int width, int height, int pieces,
                                  const double *lines, const Model *model, const double *table, double *results)
{
    for (int i = 0; i < pieces; i++) {
        if (i + 1 < pieces)
            NAME(prefetch)(image, stride, width, height, lines + LINE_FIELDS * (i + (ptrdiff_t)1), model->reach);
        NAME(measure_one)(image, stride, width, height, lines + LINE_FIELDS * (ptrdiff_t)i, model, table,
                          results + RESULT_FIELDS * (ptrdiff_t)i);
    }
}
