//! One device: adapter choice, buffers, readback; says clearly when there is none.
