//! Pictures, their gradients and photographs in the layout of hosts: row by row, pixel by pixel.
//!
//! Blending, the loss and the backward pass exchange them in the device's native layout: by rows on GPUs, in [`Strips`] on
//! software drivers. [`LayoutConverter`] converts between the two.

use crate::error::Result;
use crate::frame::{FrameInputs, LaunchSizes, Strips};
use crate::kernels::pixels::{gradient_from_rows, photo_to_rows, picture_to_rows};
use crate::vk::{Buffer, Context, Kernel, Recorder};

/// Conversions between rows and the device's native layout.
pub struct LayoutConverter {
    sizes: LaunchSizes,
    picture: Kernel<picture_to_rows::Interface>,
    /// Kernels that replace the gradient, and that add to it.
    gradient: [Kernel<gradient_from_rows::Interface>; 2],
    /// Kernels without and with a mask.
    photo: [Kernel<photo_to_rows::Interface>; 2],
}

impl LayoutConverter {
    /// Builds the kernels.
    pub fn new(context: &Context) -> Result<Self> {
        let sizes = LaunchSizes::new(context.limits());
        let (workgroup_size, strips) = (sizes.elementwise_workgroup, sizes.strips);
        let gradient = |add| Kernel::new(context, &gradient_from_rows::Spec { workgroup_size, strips, add });
        let photo = |masked| Kernel::new(context, &photo_to_rows::Spec { workgroup_size, masked });
        Ok(Self {
            picture: Kernel::new(context, &picture_to_rows::Spec { workgroup_size, strips })?,
            gradient: [gradient(false)?, gradient(true)?],
            photo: [photo(false)?, photo(true)?],
            sizes,
        })
    }

    /// Bytes of an image's native gradient: dL/d(r, g, b, inverse depth) of each pixel, with padding.
    pub fn gradient_bytes(width: u32, height: u32) -> u64 {
        // Strips have at least as many values as the image has pixels.
        16 * Strips { width, height }.values()
    }

    /// Records the conversion of a frame's picture: `rows` receives (r, g, b, 0) per pixel, composited on the background. The
    /// frame must have backward.
    pub fn record_picture(&self, r: &mut Recorder, inputs: &FrameInputs, rows: &Buffer) {
        let (width, height) = (inputs.camera.width, inputs.camera.height);
        let bind = picture_to_rows::Bind { rendered: inputs.buffers.rendered(&self.sizes), rows };
        let push = picture_to_rows::Push {
            image_width: width,
            image_height: height,
            background: inputs.settings.background,
        };
        r.dispatch(&self.picture, &bind, &push, self.workgroups(width, height));
    }

    /// Records the conversion of a picture's gradient, a vec4 per pixel, to the native one that
    /// [`Backward::record`](crate::passes::backward::Backward::record) reads, or with `add` its addition. The fourth component counts
    /// if the frame has inverse depth.
    pub fn record_gradient(
        &self,
        r: &mut Recorder,
        inputs: &FrameInputs,
        rows: &Buffer,
        native: &Buffer,
        add: bool,
    ) {
        let (width, height) = (inputs.camera.width, inputs.camera.height);
        let push = gradient_from_rows::Push {
            image_width: width,
            image_height: height,
            planes: if inputs.settings.inverse_depth { 4 } else { 3 },
        };
        let bind = gradient_from_rows::Bind { rows, image_gradient: native };
        r.dispatch(&self.gradient[usize::from(add)], &bind, &push, self.workgroups(width, height));
    }

    /// Records the conversion of a native photograph with 8 bits per channel
    /// ([`photo_on_device`](crate::passes::loss::photo_on_device)): `rows` receives (r, g, b, mask) per pixel, a byte each.
    pub fn record_photo(
        &self,
        r: &mut Recorder,
        (width, height): (u32, u32),
        masked: bool,
        native: &Buffer,
        rows: &Buffer,
    ) {
        if !self.sizes.strips {
            let bytes = 4 * u64::from(width) * u64::from(height);
            return r.copy(&native.range(0, bytes), &rows.range(0, bytes));
        }
        let push = photo_to_rows::Push { image_width: width, image_height: height };
        let bind = photo_to_rows::Bind { photo: native, rows };
        r.dispatch(&self.photo[usize::from(masked)], &bind, &push, self.workgroups(width, height));
    }

    fn workgroups(&self, width: u32, height: u32) -> u64 {
        self.sizes.groups(u64::from(width) * u64::from(height))
    }
}
