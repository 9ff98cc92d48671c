//! The connection to the display.

use super::present::unfit;
use super::words::no_display;
use ashsplat::Result;
use std::panic;
use winit::event_loop::EventLoop;

/// Connects to the display of this session.
///
/// # Errors
/// One line, if there is no display.
pub fn open() -> Result<EventLoop<()>> {
    // winit panics if a display library or an extension of the server is missing.
    let before = panic::take_hook();
    panic::set_hook(Box::new(|_| {}));
    let opened = panic::catch_unwind(|| EventLoop::builder().build());
    panic::set_hook(before);
    match opened {
        Ok(Ok(events)) => Ok(events),
        Ok(Err(error)) => Err(unfit(&no_display(&error.to_string()))),
        Err(payload) => {
            let text = payload.downcast_ref::<String>().cloned();
            let text = text.or_else(|| payload.downcast_ref::<&str>().map(|text| (*text).to_owned()));
            Err(unfit(&no_display(&text.unwrap_or_default())))
        }
    }
}
