// Functions and comparisons of expressions, from kernels/src/expression.rs. Generated: `make generated`.
#ifndef ISOPEEL_OPERATIONS_H
#define ISOPEEL_OPERATIONS_H

#define OPERATION_CASES \
    case 8u: value = -x; break; \
    case 9u: value = fabs(x); break; \
    case 10u: value = sqrt(x); break; \
    case 11u: value = exp(x); break; \
    case 12u: value = log(x); break; \
    case 13u: value = log2(x); break; \
    case 14u: value = log10(x); break; \
    case 15u: value = sin(x); break; \
    case 16u: value = cos(x); break; \
    case 17u: value = tan(x); break; \
    case 18u: value = floor(x); break; \
    case 19u: value = ceil(x); break; \
    case 20u: value = x + y; break; \
    case 21u: value = x - y; break; \
    case 22u: value = x * y; break; \
    case 23u: value = x / y; break; \
    case 24u: value = pow(x, y); break; \
    case 25u: value = fmin(x, y); break; \
    case 26u: value = fmax(x, y); break; \
    case 27u: value = PICK(x < y, 1.0f, 0.0f); break; \
    case 28u: value = PICK(x <= y, 1.0f, 0.0f); break; \
    case 29u: value = PICK(x > y, 1.0f, 0.0f); break; \
    case 30u: value = PICK(x >= y, 1.0f, 0.0f); break; \
    case 31u: value = PICK(x == y, 1.0f, 0.0f); break; \
    case 32u: value = PICK(x != y, 1.0f, 0.0f); break;

#endif
