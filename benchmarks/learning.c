/* The paper's scene by hand: forward pass, its adjoint, and learning, for one robot on flat ground without slip.
 *
 * The equations are those of docs/reference/engine.md (preset "paper"), nothing is left out and nothing is added:
 * masses of 1 kg, springs, a network of 32 hidden units, semi-implicit Euler, updates of one length. It is the ruler for
 * the engine's speed: one file, one thread, arrays of structures of vectors, no library.
 *
 * Compiled by benchmarks/by_hand.py, once with REAL=float and once with REAL=double. A vector is as long as the
 * processor's: GCC splits longer ones so badly that it takes twice the time.
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

typedef REAL real;
#ifdef __AVX512F__
enum { BYTES = 64 };
#else
enum { BYTES = 32 };
#endif
enum { W = BYTES / sizeof(real), H = 32, WAVES = 10, CHUNK = 8 };
typedef real vec __attribute__((vector_size(BYTES)));

typedef struct {
    int masses, springs, motors, steps;
    double dt, gravity, damping, stiffness, actuation, omega, ground;
    const double *start;      /* positions after placement [m], (masses, 2) */
    const int *ends;          /* masses of each spring, (springs, 2) */
    const double *rest;       /* rest lengths [m], (springs,) */
    const int *motor;         /* motor of each spring, or -1 */
} Robot;

typedef struct {
    int M, S, A, in, out;     /* padded counts: masses, springs, motors, vectors of inputs and of outputs */
    real *w1, *w2, *b1, *b2;  /* matrices as [vector][hidden][lane]: the long side lies in vectors */
    real *g1, *g2, *gb1, *gb2;
    size_t n1, n2;
    real *x, *y, *vx, *vy;    /* histories, (steps + 1, M) */
    real *u, *h, *a;          /* inputs, hidden units, outputs of every step */
    real *ux, *uy, *ix, *iy;  /* positions at rest about their centre; impulses */
    real *px, *py, *qx, *qy;  /* adjoints of positions and velocities */
    real *rest, *gain, *fx, *fy;
    real *dh, *da, *du, *ga, *full, *gx, *gy, *sx, *sy;
    int *pa, *pb;             /* motors first: spring m is motor m, the others follow */
    int *at;                  /* springs at each mass, (6, M): index of the spring, with its sign below */
    real *sign;
} Work;

static void *room(size_t bytes) {
    void *p = aligned_alloc(BYTES, (bytes + BYTES - 1) / BYTES * BYTES);
    if (p) memset(p, 0, (bytes + BYTES - 1) / BYTES * BYTES);
    return p;
}
#define ROOM(n) room((size_t)(n) * sizeof(real))

/* out(long) = matrix . hidden */
static void to_long(int n, const real *w, const real *hidden, real *out) {
    for (int b = 0; b < n; b++) {
        const vec *row = (const vec *)(w + (size_t)b * H * W);
        vec s0 = {0}, s1 = {0}, s2 = {0}, s3 = {0};
        for (int j = 0; j < H; j += 4) {
            s0 += row[j] * hidden[j];
            s1 += row[j + 1] * hidden[j + 1];
            s2 += row[j + 2] * hidden[j + 2];
            s3 += row[j + 3] * hidden[j + 3];
        }
        *(vec *)(out + (size_t)b * W) = (s0 + s1) + (s2 + s3);
    }
}

/* out(hidden) += matrix^T . long */
static void to_hidden(int n, const real *w, const real *line, real *out) {
    for (int half = 0; half < H; half += H / 2) {
        vec s[H / 2];
        for (int j = 0; j < H / 2; j++) s[j] = (vec){0};
        for (int b = 0; b < n; b++) {
            const vec *row = (const vec *)(w + ((size_t)b * H + half) * W);
            vec l = *(const vec *)(line + (size_t)b * W);
            for (int j = 0; j < H / 2; j++) s[j] += row[j] * l;
        }
        for (int j = 0; j < H / 2; j++) {
            real sum = 0;
            for (int k = 0; k < W; k++) sum += s[j][k];
            out[half + j] += sum;
        }
    }
}

/* gradient of the matrix += sum over a chunk of steps of long x hidden */
static void outer(int n, int steps, real *g, const real *line, size_t stride, const real *hidden) {
    for (int b = 0; b < n; b++) {
        vec *row = (vec *)(g + (size_t)b * H * W);
        for (int j = 0; j < H; j++) {
            vec s = row[j];
            for (int k = 0; k < steps; k++) s += *(const vec *)(line + k * stride + (size_t)b * W) * hidden[k * H + j];
            row[j] = s;
        }
    }
}

static real root(real z) {
#ifdef SINGLE
    return sqrtf(z);
#else
    return sqrt(z);
#endif
}

static real rational_tanh(real z) {
#ifdef SINGLE
    /* To 1e-7, as the engine: an odd rational function of z within +-8. */
    real c = z < (real)-7.90531110763549805 ? (real)-7.90531110763549805 : z > (real)7.90531110763549805 ? (real)7.90531110763549805 : z;
    real q = c * c;
    real p = (real)-2.76076847742355e-16;
    p = p * q + (real)2.00018790482477e-13;
    p = p * q + (real)-8.60467152213735e-11;
    p = p * q + (real)5.12229709037114e-08;
    p = p * q + (real)1.48572235717979e-05;
    p = p * q + (real)6.37261928875436e-04;
    p = p * q + (real)4.89352455891786e-03;
    real d = (real)1.19825839466702e-06;
    d = d * q + (real)1.18534705686654e-04;
    d = d * q + (real)2.26843463243900e-03;
    d = d * q + (real)4.89352518554385e-03;
    return c * p / d;
#else
    return tanh(z);
#endif
}

/* Pull of each spring on its ends, as the change of its first mass's velocity with the sign reversed [m/s]. */
static void springs(int S, real k, const int *restrict pa, const int *restrict pb,
                    const real *restrict rest, const real *restrict gain, const real *restrict a,
                    const real *restrict x, const real *restrict y, real *restrict fx, real *restrict fy) {
    for (int s = 0; s < S; s++) {
        real dx = x[pa[s]] - x[pb[s]], dy = y[pa[s]] - y[pb[s]];
        real length = root(dx * dx + dy * dy) + (real)1e-4;
        real f = k * (1 - rest[s] * (1 + gain[s] * a[s]) / length);
        fx[s] = f * dx;
        fy[s] = f * dy;
    }
}

/* Adjoint of `springs`: (gx, gy) are those of the masses' velocities, (cx, cy) those of a spring's vector, ga that of
 * its motor. */
static void springs_back(int S, real k, const int *restrict pa, const int *restrict pb,
                         const real *restrict rest, const real *restrict gain, const real *restrict a,
                         const real *restrict x, const real *restrict y, const real *restrict gx,
                         const real *restrict gy, real *restrict cx, real *restrict cy, real *restrict ga) {
    for (int s = 0; s < S; s++) {
        int i = pa[s], j = pb[s];
        real dx = x[i] - x[j], dy = y[i] - y[j], norm = root(dx * dx + dy * dy), length = norm + (real)1e-4;
        real target = rest[s] * (1 + gain[s] * a[s]), f = k * (1 - target / length);
        real ex = gx[j] - gx[i], ey = gy[j] - gy[i], along = ex * dx + ey * dy;
        real stretch = k * target / (length * length) * along / (norm + (real)1e-30);
        cx[s] = f * ex + stretch * dx;
        cy[s] = f * ey + stretch * dy;
        ga[s] = -k * rest[s] * gain[s] / length * along;
    }
}

/* Sum over the springs at each mass, with the sign of its end. */
static void gather(int M, const int *restrict at, const real *restrict sign, const real *restrict fx,
                   const real *restrict fy, real *restrict sx, real *restrict sy) {
    for (int i = 0; i < M; i++) sx[i] = sy[i] = 0;
    for (int k = 0; k < 6; k++)
        for (int i = 0; i < M; i++) {
            sx[i] += sign[k * M + i] * fx[at[k * M + i]];
            sy[i] += sign[k * M + i] * fy[at[k * M + i]];
        }
}

/* Everything after the loss of a step: positions, velocities and activations of all steps. Returns the loss [m]. */
static real forward(const Robot *r, Work *w) {
    const int M = w->M, n = r->masses;
    const real dt = (real)r->dt, decay = (real)exp(-r->damping * r->dt), fall = (real)(r->dt * r->gravity);
    const real k = (real)(r->dt * r->stiffness);
    const real ground = (real)r->ground, landing = (real)(-0.025 * r->dt);
    for (int t = 0; t < r->steps; t++) {
        const size_t now = (size_t)t * M, next = now + M;
        real *u = w->u + (size_t)t * w->in * W, *h = w->h + (size_t)t * H, *a = w->a + (size_t)t * w->out * W;
        real *x = w->x + now, *y = w->y + now, *vx = w->vx + now, *vy = w->vy + now, mx = 0, my = 0;
        for (int i = 0; i < M; i++) { mx += x[i]; my += y[i]; } /* what pads is 0 */
        mx /= n; my /= n;
        for (int i = 0; i < M; i++) {
            u[i] = (real)0.05 * (x[i] - mx - w->ux[i]);
            u[M + i] = (real)0.05 * (y[i] - my - w->uy[i]);
            u[2 * M + i] = (real)0.05 * vx[i];
            u[3 * M + i] = (real)0.05 * vy[i];
        }
        for (int i = n; i < M; i++) u[i] = u[M + i] = 0; /* what pads has no part in gradients */
        memcpy(h, w->b1, H * sizeof(real));
        to_hidden(w->in, w->w1, u, h);
        for (int j = 0; j < H; j++) h[j] = rational_tanh(h[j]);
        to_long(w->out, w->w2, h, a);
        for (int m = 0; m < w->A; m++) a[m] = rational_tanh(a[m] + w->b2[m]);
        memcpy(w->full, a, w->A * sizeof(real));
        springs(w->S, k, w->pa, w->pb, w->rest, w->gain, w->full, x, y, w->fx, w->fy);
        real *restrict ix = w->ix + now, *restrict iy = w->iy + now; /* velocities before contact: the adjoint needs them */
        real *restrict nx = w->x + next, *restrict ny = w->y + next;
        real *restrict nvx = w->vx + next, *restrict nvy = w->vy + next;
        gather(M, w->at, w->sign, w->fx, w->fy, ix, iy);
        for (int i = 0; i < M; i++) {
            real wx = decay * vx[i] + ix[i], wy = decay * vy[i] + iy[i] + fall;
            int lands = (y[i] + dt * wy < ground) & (wy < landing);
            real until = lands ? (ground - y[i]) / (lands ? wy : 1) : dt;
            ix[i] = wx;
            iy[i] = wy;
            nx[i] = x[i] + until * wx;
            ny[i] = y[i] + until * wy;
            nvx[i] = lands ? 0 : wx;
            nvy[i] = lands ? 0 : wy;
        }
        for (int i = n; i < M; i++) nx[i] = ny[i] = nvx[i] = nvy[i] = 0;
    }
    real loss = 0;
    const real *last = w->x + (size_t)r->steps * M;
    for (int i = 0; i < n; i++) loss += w->x[i] - last[i];
    return loss / n;
}

/* Gradient of the loss with respect to all weights, from the history that `forward` left. */
static void backward(const Robot *r, Work *w) {
    const int M = w->M, n = r->masses;
    const real dt = (real)r->dt, decay = (real)exp(-r->damping * r->dt), k = (real)(r->dt * r->stiffness);
    const real ground = (real)r->ground, landing = (real)(-0.025 * r->dt);
    real *restrict px = w->px, *restrict py = w->py, *restrict qx = w->qx, *restrict qy = w->qy;
    real *restrict gx = w->gx, *restrict gy = w->gy, *restrict sx = w->sx, *restrict sy = w->sy;
    memset(w->g1, 0, w->n1 * sizeof(real));
    memset(w->g2, 0, w->n2 * sizeof(real));
    memset(w->gb1, 0, H * sizeof(real));
    memset(w->gb2, 0, (size_t)w->out * W * sizeof(real));
    for (int i = 0; i < M; i++) { px[i] = i < n ? (real)-1 / n : 0; py[i] = qx[i] = qy[i] = 0; }
    for (int t = r->steps - 1; t >= 0; t--) {
        const size_t now = (size_t)t * M;
        const int slot = t % CHUNK;
        const real *restrict x = w->x + now, *restrict y = w->y + now, *restrict ix = w->ix + now, *restrict iy = w->iy + now;
        const real *a = w->a + (size_t)t * w->out * W, *h = w->h + (size_t)t * H;
        real *da = w->da + (size_t)slot * w->out * W, *dh = w->dh + slot * H;
        for (int i = 0; i < M; i++) { /* contact and integration: adjoints of the velocities before contact */
            real wx = ix[i], wy = iy[i];
            int lands = (y[i] + dt * wy < ground) & (wy < landing);
            real safe = lands ? wy : 1, until = lands ? (ground - y[i]) / safe : dt, slide = wx / safe * px[i];
            gx[i] = until * px[i] + (lands ? 0 : qx[i]);
            gy[i] = lands ? -until * slide : dt * py[i] + qy[i];
            py[i] = lands ? -slide : py[i];
            qx[i] = decay * gx[i];
            qy[i] = decay * gy[i];
        }
        memcpy(w->full, a, w->A * sizeof(real));
        springs_back(w->S, k, w->pa, w->pb, w->rest, w->gain, w->full, x, y, gx, gy, w->fx, w->fy, w->ga);
        gather(M, w->at, w->sign, w->fx, w->fy, sx, sy);
        for (int i = 0; i < M; i++) {
            px[i] -= sx[i];
            py[i] -= sy[i];
        }
        for (int m = 0; m < w->A; m++) {
            da[m] = m < r->motors ? w->ga[m] * (1 - a[m] * a[m]) : 0;
            w->gb2[m] += da[m];
        }
        memset(dh, 0, H * sizeof(real));
        to_hidden(w->out, w->w2, da, dh);
        for (int j = 0; j < H; j++) {
            dh[j] *= 1 - h[j] * h[j];
            w->gb1[j] += dh[j];
        }
        real *du = w->du, mx = 0, my = 0;
        to_long(w->in, w->w1, dh, du);
        for (int i = 0; i < n; i++) { mx += du[i]; my += du[M + i]; }
        mx /= n; my /= n;
        for (int i = 0; i < n; i++) {
            px[i] += (real)0.05 * (du[i] - mx);
            py[i] += (real)0.05 * (du[M + i] - my);
            qx[i] += (real)0.05 * du[2 * M + i];
            qy[i] += (real)0.05 * du[3 * M + i];
        }
        if (slot == 0) {
            int steps = r->steps - t < CHUNK ? r->steps - t : CHUNK;
            outer(w->in, steps, w->g1, w->u + (size_t)t * w->in * W, (size_t)w->in * W, w->dh);
            outer(w->out, steps, w->g2, w->da, (size_t)w->out * W, w->h + (size_t)t * H);
        }
    }
}

static int up(int n, int to) { return (n + to - 1) / to * to; }

static int begin(const Robot *r, Work *w) {
    const int M = w->M = up(r->masses, W), T = r->steps + 1;
    w->S = up(r->springs, W);
    w->A = up(r->motors ? r->motors : 1, W);
    w->in = 4 * M / W + up(WAVES, W) / W;
    w->out = w->A / W;
    w->n1 = (size_t)w->in * H * W;
    w->n2 = (size_t)w->out * H * W;
    w->w1 = ROOM(w->n1); w->g1 = ROOM(w->n1); w->w2 = ROOM(w->n2); w->g2 = ROOM(w->n2);
    w->b1 = ROOM(H); w->gb1 = ROOM(H); w->b2 = ROOM(w->A); w->gb2 = ROOM(w->A);
    w->x = ROOM(T * M); w->y = ROOM(T * M); w->vx = ROOM(T * M); w->vy = ROOM(T * M);
    w->ix = ROOM(T * M); w->iy = ROOM(T * M);
    w->u = ROOM((size_t)T * w->in * W); w->h = ROOM(T * H); w->a = ROOM(T * w->A);
    w->ux = ROOM(M); w->uy = ROOM(M); w->gx = ROOM(M); w->gy = ROOM(M); w->sx = ROOM(M); w->sy = ROOM(M);
    w->px = ROOM(M); w->py = ROOM(M); w->qx = ROOM(M); w->qy = ROOM(M);
    w->rest = ROOM(w->S); w->gain = ROOM(w->S); w->fx = ROOM(w->S); w->fy = ROOM(w->S);
    w->dh = ROOM(CHUNK * H); w->da = ROOM(CHUNK * w->A); w->du = ROOM(w->in * W); w->full = ROOM(w->S);
    w->pa = room(w->S * sizeof(int)); w->pb = room(w->S * sizeof(int));
    w->at = room(6 * M * sizeof(int)); w->sign = ROOM(6 * M); w->ga = ROOM(w->S);
    for (int t = 0; t < r->steps; t++)
        for (int j = 0; j < WAVES; j++)
            w->u[((size_t)t * w->in) * W + 4 * M + j] = (real)sin(r->omega * t * r->dt + 2 * M_PI * j / WAVES);
    real cx = 0, cy = 0;
    for (int i = 0; i < r->masses; i++) {
        cx += w->x[i] = (real)r->start[2 * i];
        cy += w->y[i] = (real)r->start[2 * i + 1];
    }
    for (int i = 0; i < r->masses; i++) {
        w->ux[i] = w->x[i] - cx / r->masses;
        w->uy[i] = w->y[i] - cy / r->masses;
    }
    int *filled = calloc(M, sizeof(int));
    for (int given = 0, passive = r->motors; given < r->springs; given++) {
        int motor = r->motor[given], s = motor < 0 ? passive++ : motor;
        int ends[2] = {r->ends[2 * given], r->ends[2 * given + 1]};
        w->pa[s] = ends[0]; w->pb[s] = ends[1];
        w->rest[s] = (real)r->rest[given];
        w->gain[s] = motor < 0 ? 0 : (real)r->actuation;
        for (int e = 0; e < 2; e++) {
            int q = filled[ends[e]]++;
            if (q == 6) { free(filled); return 1; } /* the lattice has no such mass */
            w->at[q * M + ends[e]] = s;
            w->sign[q * M + ends[e]] = e ? 1 : -1;
        }
    }
    free(filled);
    return 0;
}

static void end(Work *w) {
    void *all[] = {w->w1, w->g1, w->w2, w->g2, w->b1, w->gb1, w->b2, w->gb2, w->x, w->y, w->vx, w->vy, w->ix, w->iy, w->u,
                   w->h, w->a, w->ux, w->uy, w->px, w->py, w->qx, w->qy, w->rest, w->gain, w->fx, w->fy, w->dh, w->da,
                   w->du, w->ga, w->full, w->gx, w->gy, w->sx, w->sy, w->pa, w->pb, w->at, w->sign};
    for (size_t i = 0; i < sizeof all / sizeof *all; i++) free(all[i]);
}

/* Between a flat list of weights (w1 by rows: waves, then x, y, vx, vy of each mass; b1; w2; b2) and the vectors. */
static void convert(const Robot *r, const Work *w, double *flat, real *w1, real *b1, real *w2, real *b2, int out) {
    double *f = flat;
    for (int j = 0; j < H; j++)
        for (int i = 0; i < WAVES + 4 * r->masses; i++, f++) {
            int l = i < WAVES ? 4 * w->M + i : (i - WAVES) % 4 * w->M + (i - WAVES) / 4;
            real *at = w1 + ((size_t)(l / W) * H + j) * W + l % W;
            if (out) *f = *at; else *at = (real)*f;
        }
    for (int j = 0; j < H; j++, f++) { if (out) *f = b1[j]; else b1[j] = (real)*f; }
    for (int m = 0; m < r->motors; m++)
        for (int j = 0; j < H; j++, f++) {
            real *at = w2 + ((size_t)(m / W) * H + j) * W + m % W;
            if (out) *f = *at; else *at = (real)*f;
        }
    for (int m = 0; m < r->motors; m++, f++) { if (out) *f = b2[m]; else b2[m] = (real)*f; }
}

static real square(const real *p, size_t n) {
    real sum = 0;
    for (size_t i = 0; i < n; i++) sum += p[i] * p[i];
    return sum;
}

static void step(real *p, const real *g, size_t n, real by) {
    for (size_t i = 0; i < n; i++) p[i] -= by * g[i];
}

/* The gradient of one robot's loss, in the order of its weights. Returns the loss [m], NaN without memory. */
double gradient(const Robot *r, double *weights, double *slopes) {
    Work w;
    memset(&w, 0, sizeof w);
    if (begin(r, &w)) return NAN;
    convert(r, &w, weights, w.w1, w.b1, w.w2, w.b2, 0);
    double loss = forward(r, &w);
    backward(r, &w);
    convert(r, &w, slopes, w.g1, w.gb1, w.g2, w.gb2, 1);
    end(&w);
    return loss;
}

/* Learning: losses before the first and after each update, (iterations + 1,); the best weights replace the given ones. */
int learn(const Robot *r, double *weights, int iterations, double length, double *losses) {
    Work w;
    memset(&w, 0, sizeof w);
    if (begin(r, &w)) return 1;
    convert(r, &w, weights, w.w1, w.b1, w.w2, w.b2, 0);
    double least = 1e300;
    for (int k = 0; k <= iterations; k++) {
        losses[k] = forward(r, &w);
        if (losses[k] < least) {
            least = losses[k];
            convert(r, &w, weights, w.w1, w.b1, w.w2, w.b2, 1);
        }
        if (k == iterations) break;
        backward(r, &w);
        real norm = square(w.g1, w.n1) + square(w.g2, w.n2) + square(w.gb1, H) + square(w.gb2, w.A);
        real by = (real)length / ((real)sqrt(norm) + (real)1e-6);
        step(w.w1, w.g1, w.n1, by);
        step(w.w2, w.g2, w.n2, by);
        step(w.b1, w.gb1, H, by);
        step(w.b2, w.gb2, w.A, by);
    }
    end(&w);
    return 0;
}
