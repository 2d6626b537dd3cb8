//! The `akrobat` binary.

use akrobat::CancelToken;

fn main() {
    let cancel = CancelToken::default();
    let on_interrupt = cancel.clone();
    // The first Ctrl-C asks the stages to stop and leave only whole files; the second does not wait.
    let handler = ctrlc::set_handler(move || {
        if on_interrupt.cancel() {
            std::process::exit(130);
        }
    });
    if let Err(error) = handler {
        eprintln!("warning: Ctrl-C will not stop cleanly: {error}");
    }
    std::process::exit(akrobat::run(std::env::args_os(), None, &cancel));
}
