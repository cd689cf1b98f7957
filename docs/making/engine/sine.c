/* Correctly rounded sine and cosine: the same bits on every machine, which no two libraries promise.

   An angle is reduced by multiples of a quarter turn, and its series summed, in pairs of doubles: 106 bits, of which 53
   are returned. Chipmunk calls both once for a body and step. Compile without contraction of products and sums. */
#include <math.h>

typedef struct {
  double high, low;
} pair;

static const double quarter[3] = {0x1.921fb54442d18p+0, 0x1.1a62633145c07p-54, -0x1.f1976b7ed8fbcp-110};
static const pair odd[14] = { /* (-1)^k / (2k + 1)! */
    {0x1.0000000000000p+0, 0x0.0p+0},
    {-0x1.5555555555555p-3, -0x1.5555555555555p-57},
    {0x1.1111111111111p-7, 0x1.1111111111111p-63},
    {-0x1.a01a01a01a01ap-13, -0x1.a01a01a01a01ap-73},
    {0x1.71de3a556c734p-19, -0x1.c154f8ddc6c00p-73},
    {-0x1.ae64567f544e4p-26, 0x1.c062e06d1f209p-80},
    {0x1.6124613a86d09p-33, 0x1.f28e0cc748ebep-87},
    {-0x1.ae7f3e733b81fp-41, -0x1.1d8656b0ee8cbp-97},
    {0x1.952c77030ad4ap-49, 0x1.ac981465ddc6cp-103},
    {-0x1.2f49b46814157p-57, -0x1.2650f61dbdcb4p-112},
    {0x1.71b8ef6dcf572p-66, -0x1.d043ae40c4647p-120},
    {-0x1.761b41316381ap-75, 0x1.3423c7d91404fp-130},
    {0x1.3f3ccdd165fa9p-84, -0x1.58ddadf344487p-139},
    {-0x1.d1ab1c2dccea3p-94, -0x1.054d0c78aea14p-149}};
static const pair even[14] = { /* (-1)^k / (2k)! */
    {0x1.0000000000000p+0, 0x0.0p+0},
    {-0x1.0000000000000p-1, 0x0.0p+0},
    {0x1.5555555555555p-5, 0x1.5555555555555p-59},
    {-0x1.6c16c16c16c17p-10, 0x1.f49f49f49f49fp-65},
    {0x1.a01a01a01a01ap-16, 0x1.a01a01a01a01ap-76},
    {-0x1.27e4fb7789f5cp-22, -0x1.cbbc05b4fa99ap-76},
    {0x1.1eed8eff8d898p-29, -0x1.2aec959e14c06p-83},
    {-0x1.93974a8c07c9dp-37, -0x1.05d6f8a2efd1fp-92},
    {0x1.ae7f3e733b81fp-45, 0x1.1d8656b0ee8cbp-101},
    {-0x1.6827863b97d97p-53, -0x1.eec01221a8b0bp-107},
    {0x1.e542ba4020225p-62, 0x1.ea72b4afe3c2fp-120},
    {-0x1.0ce396db7f853p-70, 0x1.aebcdbd20331cp-124},
    {0x1.f2cf01972f578p-80, -0x1.9ada5fcc1ab14p-135},
    {-0x1.88e85fc6a4e5ap-89, 0x1.71c37ebd16540p-143}};

static pair sum(double a, double b) {
  double s = a + b, t = s - a;
  return (pair){s, (a - (s - t)) + (b - t)};
}

static pair product(double a, double b) {
  double p = a * b, s = 134217729.0 * a, t = 134217729.0 * b;
  double ah = s - (s - a), al = a - ah, bh = t - (t - b), bl = b - bh;
  return (pair){p, ((ah * bh - p) + ah * bl + al * bh) + al * bl};
}

static pair add(pair a, pair b) {
  pair s = sum(a.high, b.high), t = sum(a.low, b.low);
  s = sum(s.high, s.low + t.high);
  return sum(s.high, s.low + t.low);
}

static pair times(pair a, pair b) {
  pair p = product(a.high, b.high);
  return sum(p.high, p.low + (a.high * b.low + a.low * b.high));
}

static double wave(double angle, int shift) {
  if (!(fabs(angle) < 1e8))
    return NAN; /* no body turns so far */
  double turns = rint(angle / quarter[0]);
  pair rest = {angle, 0.0};
  for (int k = 0; k < 3; k++)
    rest = add(rest, product(-turns, quarter[k]));
  pair square = times(rest, rest);
  int corner = (int)((long long)turns + shift) & 3;
  const pair *series = corner & 1 ? even : odd;
  pair value = series[13];
  for (int k = 12; k >= 0; k--)
    value = add(times(value, square), series[k]);
  if (!(corner & 1))
    value = times(value, rest);
  return corner & 2 ? -value.high : value.high;
}

double sin(double angle) { return fabs(angle) < 1e-8 ? angle : wave(angle, 0); }
double cos(double angle) { return wave(angle, 1); }
void sincos(double angle, double *sine, double *cosine) {
  *sine = sin(angle);
  *cosine = cos(angle);
}
