//! The plate as it is: every mark's position, the lens's distortion and the camera's poses from many frames.
