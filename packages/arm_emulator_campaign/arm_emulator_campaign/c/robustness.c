#include "robustness.h"

#include <math.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include "formula.h"

/* A segment of a window. Of always and eventually, `hold` alone: the minimum or maximum. Of until,
 * `hold` is the minimum of the left side, `reach` the best that the right side has within it. */
typedef struct segment {
  double hold, reach;
} segment;

/* Values of a node at times first, first + 1, ..., of which its parent has taken some. */
typedef struct stream {
  double* values;
  int64_t room, begin, count; /* values[begin .. begin + count) wait to be taken */
  int64_t copied_room;        /* of this stream in a copy */
  int fixed;                  /* not 0: there is no more room, nor for its node's block */
  int64_t total;              /* all so far */
  const double* fed;          /* not null: they wait there, where they were fed */
} stream;

typedef struct node {
  robustness_node what;
  int64_t first, last; /* times at which its value is asked for; last FOREVER: to the end */
  stream out;
  /* The window of always, eventually and until that ends: the newest block of `width` samples, the
   * part of it that has not come yet holding what the block before makes up from there on. */
  segment* block;
  int64_t room; /* of the block so far: a window may be longer than any trace */
  int64_t copied_room;
  int64_t late; /* values that it may have at the end of a trace alone */
  int64_t width;
  int64_t taken;  /* samples of its children */
  segment newest; /* of the samples of the block that have come, or of all without an end */
} node;

struct robustness {
  int32_t count;
  int64_t samples;
  node nodes[];
};

/* Of truth values, see formula.h: none is NaN, and 0 is undefined. */
static double min_of(double a, double b) { return a < b ? a : b; }
static double max_of(double a, double b) { return a > b ? a : b; }

static int has_two(const node* one) {
  const int32_t kind = one->what.kind;
  return kind == ROBUSTNESS_AND || kind == ROBUSTNESS_OR || kind == ROBUSTNESS_UNTIL;
}
static int is_window(const node* one) { return one->what.kind >= ROBUSTNESS_UNTIL; }
static int has_end(const node* one) { return one->what.end != ROBUSTNESS_FOREVER; }
/* Whether it is asked for at one time alone, so that a window without end is a running value. */
static int is_once(const node* one) { return one->first == one->last; }

static segment make_empty_segment(int32_t kind) {
  const segment none = {kind == ROBUSTNESS_EVENTUALLY ? -INFINITY : INFINITY, -INFINITY};
  return none;
}

static segment join_segments(int32_t kind, segment a, segment b) {
  segment both = {0.0, 0.0};
  if (kind == ROBUSTNESS_ALWAYS) both.hold = min_of(a.hold, b.hold);
  if (kind == ROBUSTNESS_EVENTUALLY) both.hold = max_of(a.hold, b.hold);
  if (kind == ROBUSTNESS_UNTIL) {
    both.hold = min_of(a.hold, b.hold);
    both.reach = max_of(a.reach, min_of(a.hold, b.reach));
  }
  return both;
}

static double value_of(int32_t kind, segment one) {
  return kind == ROBUSTNESS_UNTIL ? one.reach : one.hold;
}

/* ------------------------------------------------------------------------------------- streams */

static int make_room(stream* one, int64_t more) {
  if (one->begin > 0 && one->begin + one->count + more > one->room) {
    memmove(one->values, one->values + one->begin, (size_t)one->count * sizeof(double));
    one->begin = 0;
  }
  if (one->count + more > one->room) {
    if (one->fixed) return -1;
    const int64_t room = 2 * (one->count + more);
    double* values = realloc(one->values, (size_t)room * sizeof(double));
    if (!values) return -1;
    one->values = values;
    one->room = room;
  }
  return 0;
}

static const double* waiting(const stream* one) {
  return one->fed ? one->fed : one->values + one->begin;
}

static double* end_of(stream* one) { return one->values + one->begin + one->count; }

/* Samples that wait in both streams, or in one without a second. */
static int64_t count_pairs(const stream* left, const stream* right) {
  return right && right->count < left->count ? right->count : left->count;
}

static void grow(stream* one, int64_t by) {
  one->count += by;
  one->total += by;
}

static void take(stream* one, int64_t count) {
  if (one->fed) {
    one->fed += count;
  } else {
    one->begin += count;
  }
  one->count -= count;
}

/* Keep what was fed and not taken. */
static int keep(stream* one) {
  const double* fed = one->fed;
  const int64_t count = one->count;
  one->fed = NULL;
  if (!fed || count == 0) return 0;
  one->begin = one->count = 0;
  if (make_room(one, count)) return -1;
  memcpy(one->values, fed, (size_t)count * sizeof(double));
  one->count = count;
  return 0;
}

/* --------------------------------------------------------------------------------------- nodes */

/* The time from which a child is asked for, and up to which. */
static void ask(node* child, const node* parent) {
  const int64_t begin = is_window(parent) ? parent->what.begin : 0;
  child->first = parent->first + begin;
  child->last = parent->last;
  if (is_window(parent) && child->last != ROBUSTNESS_FOREVER) {
    child->last = has_end(parent) ? parent->last + parent->what.end : ROBUSTNESS_FOREVER;
  }
}

static void restart(robustness* all) {
  all->samples = 0;
  for (int32_t k = 0; k < all->count; ++k) {
    node* one = &all->nodes[k];
    one->out.begin = one->out.count = one->out.total = one->taken = 0;
    one->out.fed = NULL;
    one->newest = make_empty_segment(one->what.kind);
  }
}

robustness* robustness_new(const robustness_node* nodes, int32_t count) {
  if (!nodes || count < 1) return NULL;
  robustness* all = calloc(1, sizeof(robustness) + (size_t)count * sizeof(node));
  if (!all) return NULL;
  all->count = count;
  for (int32_t k = 0; k < count; ++k) all->nodes[k].what = nodes[k];
  for (int32_t k = count - 1; k >= 0; --k) {
    node* one = &all->nodes[k];
    if (one->what.kind != ROBUSTNESS_ATOM) ask(&all->nodes[one->what.left], one);
    if (has_two(one)) ask(&all->nodes[one->what.right], one);
    if (is_window(one) && has_end(one)) one->width = one->what.end - one->what.begin + 1;
  }
  restart(all);
  return all;
}

void robustness_delete(robustness* all) {
  if (!all) return;
  for (int32_t k = 0; k < all->count; ++k) {
    free(all->nodes[k].block);
    free(all->nodes[k].out.values);
  }
  free(all);
}

/* Bytes of a requirement without its streams and blocks. */
static int64_t head_size(const robustness* one) {
  return (int64_t)sizeof(robustness) + one->count * (int64_t)sizeof(node);
}

static int64_t least(int64_t a, int64_t b) { return a < b ? a : b; }
static int64_t most(int64_t a, int64_t b) { return a > b ? a : b; }

/* A shorter trace has kept as much before its last block, whose samples may wait where those of a
 * whole block were taken at once. At its end windows that have not seen all of their samples are
 * complete, and nodes above them get so many values at once. */
static void measure_node(robustness* all, node* one, int64_t longest) {
  int64_t late = 0, more = FORMULA_BLOCK;
  if (one->what.kind != ROBUSTNESS_ATOM) {
    late = all->nodes[one->what.left].late;
    if (has_two(one)) late = most(late, all->nodes[one->what.right].late);
  }
  if (is_window(one)) late = has_end(one) ? late + one->what.end + 1 : is_once(one) ? 1 : longest;
  one->late = least(late, longest);
  if (one->what.kind != ROBUSTNESS_ATOM) more = one->late;
  one->out.copied_room = least(one->out.room + more, longest);
  one->copied_room = is_window(one) && has_end(one) ? least(one->width, longest) : 0;
}

void robustness_measure(robustness* one, int64_t longest, int64_t* head, int64_t* whole) {
  *head = *whole = head_size(one);
  for (int32_t k = 0; k < one->count; ++k) {
    measure_node(one, &one->nodes[k], longest);
    *whole += one->nodes[k].out.copied_room * (int64_t)sizeof(double);
    *whole += one->nodes[k].copied_room * (int64_t)sizeof(segment);
  }
}

robustness* robustness_copy(const robustness* one, void* room) {
  robustness* copy = (robustness*)room;
  const int64_t head = head_size(one);
  memcpy(copy, one, (size_t)head);
  double* next = (double*)room + head / (int64_t)sizeof(double); /* all here is of whole doubles */
  for (int32_t k = 0; k < copy->count; ++k) {
    node* own = &copy->nodes[k];
    own->out.fixed = 1;
    own->out.room = own->out.copied_room;
    own->room = own->copied_room;
    own->out.values = next;
    next += own->out.room;
    own->block = (segment*)(void*)next;
    next += own->room * (int64_t)(sizeof(segment) / sizeof(double));
  }
  restart(copy);
  return copy;
}

/* Take the samples first .. first + count of a row that are asked for. */
static int feed_atom(node* one, const double* row, int64_t first, int64_t count) {
  int64_t from = one->first > first ? one->first - first : 0;
  int64_t to = count;
  if (one->last != ROBUSTNESS_FOREVER && one->last - first + 1 < to) to = one->last - first + 1;
  if (from >= to) return 0;
  if (one->out.count == 0) {
    one->out.fed = row + from;
    grow(&one->out, to - from);
    return 0;
  }
  if (make_room(&one->out, to - from)) return -1;
  memcpy(end_of(&one->out), row + from, (size_t)(to - from) * sizeof(double));
  grow(&one->out, to - from);
  return 0;
}

static int feed_pointwise(node* one, stream* left, stream* right) {
  const int64_t count = count_pairs(left, right);
  if (count == 0) return 0;
  if (make_room(&one->out, count)) return -1;
  const double* a = waiting(left);
  const double* b = right ? waiting(right) : a;
  double* out = end_of(&one->out);
  switch (one->what.kind) {
    case ROBUSTNESS_NOT:
      for (int64_t i = 0; i < count; ++i) out[i] = -a[i];
      break;
    case ROBUSTNESS_AND:
      for (int64_t i = 0; i < count; ++i) out[i] = min_of(a[i], b[i]);
      break;
    default:
      for (int64_t i = 0; i < count; ++i) out[i] = max_of(a[i], b[i]);
  }
  take(left, count);
  if (right) take(right, count);
  grow(&one->out, count);
  return 0;
}

/* Have room for further samples in the window's block. */
static int make_room_in_block(node* one, int64_t more) {
  int64_t room = one->taken + more;
  if (room > one->width) room = one->width;
  if (room <= one->room) return 0;
  if (one->out.fixed) return -1;
  room = room < one->width / 2 ? 2 * room : one->width;
  segment* block = realloc(one->block, (size_t)room * sizeof(segment));
  if (!block) return -1;
  one->block = block;
  one->room = room;
  return 0;
}

/* Put a sample into the window that moves, whose value goes out once it is full. `block` holds,
 * from the place of the sample on, what the block before makes up from there to its end. */
static void move(node* one, segment sample) {
  const int32_t kind = one->what.kind;
  const int64_t at = one->taken % one->width;
  one->newest = at == 0 ? sample : join_segments(kind, one->newest, sample);
  if (at == one->width - 1) {
    *end_of(&one->out) = value_of(kind, one->newest);
    grow(&one->out, 1);
    one->block[at] = sample;
    for (int64_t i = at - 1; i >= 0; --i) {
      one->block[i] = join_segments(kind, one->block[i], one->block[i + 1]);
    }
  } else {
    if (one->taken >= one->width) {
      *end_of(&one->out) = value_of(kind, join_segments(kind, one->block[at + 1], one->newest));
      grow(&one->out, 1);
    }
    one->block[at] = sample;
  }
  ++one->taken;
}

/* A segment and those of further samples: several at a time if only extremes count. */
enum { ABREAST = 8 };
static segment join_with_all(int32_t kind, segment all, const double* a, const double* b,
                             int64_t count) {
  int64_t i = 0;
  if (kind != ROBUSTNESS_UNTIL && count >= ABREAST) {
    double each[ABREAST];
    for (int k = 0; k < ABREAST; ++k) each[k] = all.hold;
    if (kind == ROBUSTNESS_ALWAYS) {
      for (; i + ABREAST <= count; i += ABREAST)
        for (int k = 0; k < ABREAST; ++k) each[k] = min_of(each[k], a[i + k]);
    } else {
      for (; i + ABREAST <= count; i += ABREAST)
        for (int k = 0; k < ABREAST; ++k) each[k] = max_of(each[k], a[i + k]);
    }
    for (int k = 0; k < ABREAST; ++k) {
      const segment one = {each[k], -INFINITY};
      all = join_segments(kind, all, one);
    }
  }
  for (; i < count; ++i) {
    const segment sample = {a[i], b[i]};
    all = join_segments(kind, all, sample);
  }
  return all;
}

static int feed_window(node* one, stream* left, stream* right) {
  const int64_t count = count_pairs(left, right);
  if (count == 0 || (!has_end(one) && !is_once(one))) return 0;
  if (make_room(&one->out, count)) return -1;
  const double* a = waiting(left);
  const double* b = right ? waiting(right) : a;
  const int32_t kind = one->what.kind;
  if (has_end(one)) {
    if (make_room_in_block(one, count)) return -1;
    for (int64_t i = 0; i < count; ++i) {
      const segment sample = {a[i], b[i]};
      move(one, sample);
    }
  } else {
    one->newest = join_with_all(kind, one->newest, a, b, count);
  }
  take(left, count);
  if (right) take(right, count);
  return 0;
}

/* A sample that a window has kept: in its block, or, without end, in its children. */
static segment stored_sample(const node* one, const stream* left, const stream* right, int64_t i) {
  if (has_end(one)) return one->block[i];
  const double a = left->values[left->begin + i];
  const segment sample = {a, right ? right->values[right->begin + i] : a};
  return sample;
}

/* Values at each time from `first` on of a window that keeps all samples: from the end back. */
static void accumulate_back(node* one, const stream* left, const stream* right, int64_t needed) {
  const int64_t count = has_end(one) ? one->taken : count_pairs(left, right);
  segment later = make_empty_segment(one->what.kind);
  double* out = end_of(&one->out);
  for (int64_t i = (count > needed ? count : needed) - 1; i >= 0; --i) {
    if (i < count) later = join_segments(one->what.kind, stored_sample(one, left, right, i), later);
    if (i < needed) out[i] = value_of(one->what.kind, later);
  }
  grow(&one->out, needed);
}

/* Complete the values of a window at the times that the trace has. */
static int end_window(robustness* all, node* one, stream* left, stream* right) {
  int64_t last = all->samples - 1;
  if (one->last != ROBUSTNESS_FOREVER && one->last < last) last = one->last;
  const int64_t needed = last - one->first + 1;
  if (needed <= one->out.total) return 0;
  if (make_room(&one->out, needed - one->out.total)) return -1;
  if (!has_end(one) && is_once(one)) {
    *end_of(&one->out) = value_of(one->what.kind, one->newest);
    grow(&one->out, needed);
  } else if (!has_end(one) || one->taken < one->width) {
    accumulate_back(one, left, right, needed);
  } else {
    while (one->out.total < needed) move(one, make_empty_segment(one->what.kind));
  }
  return 0;
}

static int add_samples(robustness* all, const double* const* rows, int64_t samples, int ends) {
  for (int32_t k = 0; k < all->count; ++k) {
    node* one = &all->nodes[k];
    const int32_t kind = one->what.kind;
    int failed = 0;
    if (kind == ROBUSTNESS_ATOM) {
      if (samples > 0) {
        failed = feed_atom(one, rows[one->what.left], all->samples, samples);
      }
    } else {
      stream* left = &all->nodes[one->what.left].out;
      stream* right = has_two(one) ? &all->nodes[one->what.right].out : NULL;
      if (is_window(one)) {
        failed = feed_window(one, left, right);
        if (!failed && ends) failed = end_window(all, one, left, right);
      } else {
        failed = feed_pointwise(one, left, right);
      }
    }
    if (failed) return -1;
  }
  for (int32_t k = 0; k < all->count; ++k)
    if (keep(&all->nodes[k].out)) return -1;
  all->samples += samples;
  return 0;
}

int robustness_feed(robustness* all, const double* const* rows, int64_t samples) {
  return add_samples(all, rows, samples, 0);
}

double robustness_end(robustness* all) {
  const stream* root = &all->nodes[all->count - 1].out;
  const int failed = add_samples(all, NULL, 0, 1);
  const double value = failed || root->count < 1 ? NAN : formula_margin(root->values[root->begin]);
  restart(all);
  return value;
}
