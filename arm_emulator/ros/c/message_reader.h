/* Messages in CDR, little- or big-endian: found field by field, checked, and read. C99.
 *
 * A table has the fields of a message, and what is read of each. Python makes the table from the
 * message's type (arm_emulator/ros/messages/message_reader.py). Rows of numbers, one per joint,
 * come in the order of the names in the message, and are read into that of the receiver.
 */
#ifndef MESSAGE_READER_H
#define MESSAGE_READER_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

enum message_use {
  MESSAGE_SKIPPED = 0,
  MESSAGE_NUMBER = 1, /* a flag or a number of 8 bytes, into 8 bytes */
  MESSAGE_TIME = 2,   /* seconds, and nanoseconds behind them, into an int64_t [ns] */
  MESSAGE_NAMES = 3,  /* those of the joints */
  MESSAGE_ROW = 4     /* numbers of 8 bytes, one per name */
};

/* Rule that a message breaks. */
enum message_rule {
  MESSAGE_READ = 0,         /* none */
  MESSAGE_OF_ITS_TYPE = 1,  /* its bytes are a message of the type */
  MESSAGE_OF_A_TIME = 2,    /* its time is logical: not negative, with less than 1e9 ns */
  MESSAGE_ROW_OF_JOINTS = 3 /* a row has one value per name, names each joint, is within bounds */
};

typedef struct message_field {
  int64_t width;       /* bytes of a number; 0: a string */
  int64_t count;       /* of numbers or strings; -1: the message has it */
  int32_t use;         /* enum message_use */
  int32_t is_flag;     /* 1: a number other than 0 is read as 1 */
  int32_t is_real;     /* 1: the numbers of a row are double, else int64_t */
  int32_t is_optional; /* 1: a row may be empty, and nothing is read then */
  void* to;
  const double* most; /* largest sizes in a row, by the receiver's order */
  /* In the newest message. */
  int64_t came; /* numbers or strings */
  int64_t at;   /* byte of the first one */
} message_field;

typedef struct message_reader {
  uint32_t size;
  int32_t fields;
  message_field* field;
  int64_t joints;
  const char** name; /* of each joint, in the receiver's order */
  int64_t* place;    /* in that order, of each joint in the message */
  /* The bytes of names to which these places belong: the same names come again and again. */
  uint8_t* known;
  int64_t known_room, known_size;
  int32_t known_swapped;
  /* The newest message. */
  int32_t is_swapped; /* the other byte order */
  const uint8_t* data;
  int64_t length, at;
  int64_t names;           /* field that has the names */
  int32_t has_known_names; /* 1: the places are those of this message */
  int32_t rule;            /* enum message_rule: the one that it breaks, */
  int64_t refused;         /* and the field that breaks it */
} message_reader;

/* Find the fields of a message, and read its time and single numbers. 0: it is refused. */
int message_open(message_reader* own, const uint8_t* data, int64_t length);
/* Read the rows of the message that was opened last. 0: it is refused. */
int message_rows(message_reader* own);

#ifdef __cplusplus
}
#endif

#endif
