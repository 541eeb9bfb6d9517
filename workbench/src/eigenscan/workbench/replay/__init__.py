"""Process replay: the real cores receive the recorded inputs, and must publish the recorded outputs."""
