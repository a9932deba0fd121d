/* The passive complementary filter with a magnetometer as a plain loop: one setting after the other, one recording after
 * the other, in float, no history stored. The peer of jaxest's batched filter; same formulas, same initial samples.
 *
 * gyr, acc, mag: (trials, steps, 3), the latter two unit vectors; gain: (settings, 2) of K_p, K_i; out: (trials, settings, 4) final quaternions.
 */
#include <math.h>

static void turn(float q[4], const float v[3]) {
    float s = v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
    float c, k;
    if (s < 1e-8f) {
        c = 1.0f - s / 8.0f;
        k = 0.5f - s / 48.0f;
    } else {
        float angle = sqrtf(s);
        c = cosf(0.5f * angle);
        k = sinf(0.5f * angle) / angle;
    }
    float b = k * v[0], g = k * v[1], d = k * v[2];
    float w = q[0] * c - q[1] * b - q[2] * g - q[3] * d;
    float x = q[0] * b + q[1] * c + q[2] * d - q[3] * g;
    float y = q[0] * g - q[1] * d + q[2] * c + q[3] * b;
    float z = q[0] * d + q[1] * g - q[2] * b + q[3] * c;
    float n = 1.0f / sqrtf(w * w + x * x + y * y + z * z);
    q[0] = w * n;
    q[1] = x * n;
    q[2] = y * n;
    q[3] = z * n;
}

static void matrix(const float q[4], float r[9]) {
    float w = q[0], x = q[1], y = q[2], z = q[3];
    r[0] = 1 - 2 * (y * y + z * z);
    r[1] = 2 * (x * y - w * z);
    r[2] = 2 * (x * z + w * y);
    r[3] = 2 * (x * y + w * z);
    r[4] = 1 - 2 * (x * x + z * z);
    r[5] = 2 * (y * z - w * x);
    r[6] = 2 * (x * z - w * y);
    r[7] = 2 * (y * z + w * x);
    r[8] = 1 - 2 * (x * x + y * y);
}

static void begin(float q[4], const float a[3], const float m[3]) {
    float w = 1 + a[2], n = sqrtf(w * w + a[0] * a[0] + a[1] * a[1]);
    q[0] = w / n;
    q[1] = a[1] / n;
    q[2] = -a[0] / n;
    q[3] = 0;
    float r[9];
    matrix(q, r);
    float e = r[0] * m[0] + r[1] * m[1] + r[2] * m[2], f = r[3] * m[0] + r[4] * m[1] + r[5] * m[2];
    float half = 0.5f * atan2f(e, f), c = cosf(half), s = sinf(half);
    float p[4] = {c * q[0] - s * q[3], c * q[1] - s * q[2], c * q[2] + s * q[1], c * q[3] + s * q[0]};
    for (int i = 0; i < 4; i++) q[i] = p[i];
}

void filter(const float *gyr, const float *acc, const float *mag, float dt, const float *gain, long trials, long steps,
            long settings, float *out) {
    for (long t = 0; t < trials; t++)
        for (long s = 0; s < settings; s++) {
            float q[4], bias[3] = {0, 0, 0}, kp = gain[2 * s], ki = gain[2 * s + 1];
            for (long n = 0; n < steps; n++) {
                const float *g = gyr + 3 * (t * steps + n);
                const float *a = acc + 3 * (t * steps + n), *m = mag + 3 * (t * steps + n);
                float r[9], e[3], v[3];
                if (n == 0) {
                    begin(q, a, m);
                    continue;
                }
                matrix(q, r);
                float x = r[0] * m[0] + r[1] * m[1] + r[2] * m[2], y = r[3] * m[0] + r[4] * m[1] + r[5] * m[2];
                float up = r[6] * m[0] + r[7] * m[1] + r[8] * m[2], north = sqrtf(x * x + y * y);
                float d[3];
                for (int i = 0; i < 3; i++) d[i] = r[3 + i] * north + r[6 + i] * up;
                for (int i = 0; i < 3; i++) {
                    int j = (i + 1) % 3, k = (i + 2) % 3;
                    e[i] = a[j] * r[6 + k] - a[k] * r[6 + j] + m[j] * d[k] - m[k] * d[j];
                }
                for (int i = 0; i < 3; i++) {
                    bias[i] -= ki * e[i] * dt;
                    v[i] = (g[i] - bias[i] + kp * e[i]) * dt;
                }
                turn(q, v);
            }
            for (int i = 0; i < 4; i++) out[4 * (t * settings + s) + i] = q[i];
        }
}
