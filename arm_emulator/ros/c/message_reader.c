#include "message_reader.h"

#include <math.h>
#include <string.h>

enum { HEAD = 4, WORD = 4, SECOND = 1000000000 };

static int refuse(message_reader* own, int32_t rule, int64_t field) {
  own->rule = rule;
  own->refused = field;
  return 0;
}

static uint32_t word_at(const message_reader* own, int64_t at) {
  uint32_t word;
  memcpy(&word, own->data + at, sizeof word);
  return own->is_swapped ? __builtin_bswap32(word) : word;
}

static uint64_t number_at(const message_reader* own, int64_t at) {
  uint64_t number;
  memcpy(&number, own->data + at, sizeof number);
  return own->is_swapped ? __builtin_bswap64(number) : number;
}

/* Go to numbers of a width, aligned to it. 0: the message ends before their end. */
static int find(message_reader* own, int64_t width, int64_t count) {
  own->at += (HEAD - own->at) & (width - 1);
  return own->at <= own->length && count <= (own->length - own->at) / width;
}

static int find_length(message_reader* own, int64_t* length) {
  if (!find(own, WORD, 1)) return 0;
  *length = word_at(own, own->at);
  own->at += WORD;
  return 1;
}

static int skip_text(message_reader* own) {
  int64_t length;
  if (!find_length(own, &length) || length > own->length - own->at) return 0;
  own->at += length;
  return 1;
}

/* Go past names that begin as those do whose places are known. 0: they are others. */
static int skip_expected_names(message_reader* own, message_field* field) {
  own->at += (HEAD - own->at) & (WORD - 1);
  own->has_known_names = own->known_size && own->known_swapped == own->is_swapped &&
                         own->known_size <= own->length - own->at &&
                         !memcmp(own->data + own->at, own->known, (size_t)own->known_size);
  if (!own->has_known_names) return 0;
  field->came = own->joints;
  own->at += own->known_size;
  return 1;
}

/* Find a field, and go to its end. */
static int find_field(message_reader* own, message_field* field) {
  if (field->use == MESSAGE_NAMES && skip_expected_names(own, field)) return 1;
  const int64_t begins = own->at;
  field->came = field->count;
  if (field->count < 0 && !find_length(own, &field->came)) return 0;
  if (!field->width) {
    field->at = field->count < 0 ? own->at : begins;
    for (int64_t k = 0; k < field->came; ++k)
      if (!skip_text(own)) return 0;
    return 1;
  }
  if (!field->came) return 1;
  if (!find(own, field->width, field->came)) return 0;
  field->at = own->at;
  own->at += field->came * field->width;
  return 1;
}

static int64_t time_at(const message_reader* own, int64_t at) {
  const int32_t seconds = (int32_t)word_at(own, at);
  const uint32_t rest = word_at(own, at + WORD);
  return seconds < 0 || rest >= SECOND ? -1 : (int64_t)seconds * SECOND + rest;
}

/* Read a time or a single number. 0: it is no logical time. */
static int read_single(const message_reader* own, const message_field* field) {
  const int is_time = field->use == MESSAGE_TIME;
  const uint64_t number = is_time          ? (uint64_t)time_at(own, field->at)
                          : field->is_flag ? (uint64_t)(own->data[field->at] != 0)
                                           : number_at(own, field->at);
  memcpy(field->to, &number, sizeof number);
  return !is_time || (int64_t)number >= 0;
}

int message_open(message_reader* own, const uint8_t* data, int64_t length) {
  static const uint16_t unit = 1;
  own->rule = MESSAGE_READ;
  own->data = data;
  own->length = length;
  own->at = HEAD;
  own->has_known_names = 0;
  if (length < HEAD || data[0] || data[1] > 1) return refuse(own, MESSAGE_OF_ITS_TYPE, -1);
  own->is_swapped = data[1] != *(const uint8_t*)&unit;
  for (int64_t k = 0; k < own->fields; ++k)
    if (!find_field(own, own->field + k)) return refuse(own, MESSAGE_OF_ITS_TYPE, k);
  for (int64_t k = 0; k < own->fields; ++k) {
    const message_field* field = own->field + k;
    if ((field->use == MESSAGE_NUMBER || field->use == MESSAGE_TIME) && !read_single(own, field))
      return refuse(own, MESSAGE_OF_A_TIME, k);
  }
  return 1;
}

/* ------------------------------------------------------------------------------------- rows */

/* Whether the bytes of a string are a name, up to their first 0 as everyone reads them. */
static int is_name(const uint8_t* text, int64_t length, const char* name) {
  const uint8_t* end = length ? memchr(text, 0, (size_t)length) : text;
  const size_t size = end ? (size_t)(end - text) : (size_t)length;
  return size == strlen(name) && !memcmp(text, name, size);
}

static int is_among(const int64_t* some, int64_t count, int64_t place) {
  for (int64_t k = 0; k < count; ++k)
    if (some[k] == place) return 1;
  return 0;
}

/* Find the place of each name. 0: not every joint is named once. */
static int find_places(message_reader* own) {
  const message_field* names = own->field + own->names;
  own->known_size = 0;
  if (names->came != own->joints) return 0;
  own->at = names->at;
  for (int64_t k = 0; k < own->joints; ++k) {
    int64_t length, j = 0;
    if (!find_length(own, &length)) return 0;
    while (j < own->joints && !is_name(own->data + own->at, length, own->name[j])) ++j;
    if (j == own->joints || is_among(own->place, k, j)) return 0;
    own->place[k] = j;
    own->at += length;
  }
  const int64_t begins = names->at - WORD, size = own->at - begins;
  if (size > own->known_room) return 1;
  memcpy(own->known, own->data + begins, (size_t)size);
  own->known_size = size;
  own->known_swapped = own->is_swapped;
  return 1;
}

/* Read a row. 0: a number is not finite or too large. */
static int read_row(const message_reader* own, const message_field* field) {
  int within = 1;
  for (int64_t k = 0; k < field->came; ++k) {
    const uint64_t number = number_at(own, field->at + 8 * k);
    const int64_t j = own->place[k];
    double real = (double)(int64_t)number;
    if (field->is_real) memcpy(&real, &number, sizeof real);
    within &= fabs(real) <= field->most[j]; /* false of a NaN */
    memcpy((uint8_t*)field->to + 8 * j, &number, sizeof number);
  }
  return within;
}

int message_rows(message_reader* own) {
  const message_field* names = own->field + own->names;
  for (int64_t k = 0; k < own->fields; ++k) {
    const message_field* field = own->field + k;
    if (field->use != MESSAGE_ROW || (field->is_optional && !field->came)) continue;
    int is_sound = field->came == names->came;
    if (is_sound && !own->has_known_names) is_sound = own->has_known_names = find_places(own);
    if (!is_sound || !read_row(own, field)) return refuse(own, MESSAGE_ROW_OF_JOINTS, k);
  }
  return 1;
}
