// jpeg_errors.h - libjpeg-turbo over bytes in memory, with errors and warnings that jump. Internal to the codecs.
#pragma once

#include <csetjmp>
#include <cstddef>
#include <cstdio>  // jpeglib.h needs FILE and size_t

#include <jpeglib.h>

namespace relievo::jpeg {

// libjpeg knows no way out of an error but a jump: the functions that call setjmp hold nothing that would need a
// destructor.
struct JumpingErrors {
  jpeg_error_mgr base;
  std::jmp_buf jump;
};
[[noreturn]] inline void leave(j_common_ptr info) {
  std::longjmp(reinterpret_cast<JumpingErrors*>(info->err)->jump, 1);
}
// Level -1 are warnings: damaged data, which libjpeg would paper over with grey.
inline void onMessage(j_common_ptr info, int level) {
  if (level < 0) leave(info);
}
inline void ignoreText(j_common_ptr) {}

inline jpeg_error_mgr* jumpingErrors(JumpingErrors* errors) {
  jpeg_std_error(&errors->base);
  errors->base.error_exit = leave;
  errors->base.emit_message = onMessage;
  errors->base.output_message = ignoreText;
  return &errors->base;
}

// A source of bytes that all lie there; one that ends too soon is an error.
inline void nothing(j_decompress_ptr) {}
inline boolean noMoreBytes(j_decompress_ptr info) { leave(reinterpret_cast<j_common_ptr>(info)); }
inline void skipBytes(j_decompress_ptr info, long n) {
  if (n <= 0) return;
  if (static_cast<size_t>(n) > info->src->bytes_in_buffer) leave(reinterpret_cast<j_common_ptr>(info));
  info->src->next_input_byte += n;
  info->src->bytes_in_buffer -= static_cast<size_t>(n);
}
inline void readFromMemory(jpeg_decompress_struct& info, jpeg_source_mgr& source) {
  source.init_source = nothing;
  source.fill_input_buffer = noMoreBytes;
  source.skip_input_data = skipBytes;
  source.resync_to_restart = jpeg_resync_to_restart;
  source.term_source = nothing;
  info.src = &source;
}

}  // namespace relievo::jpeg
