/* Numbers of training. */
typedef float real;
