/* Numbers of tests, which compare derivatives with differences. */
typedef double real;
