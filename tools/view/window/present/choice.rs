//! Choice of a surface's format, size and mode.

use ashsplat::ash::vk;

/// Formats of a window's images, best first. Pictures are display-encoded already: an sRGB format would encode them twice.
const FORMATS: [vk::Format; 5] = [
    vk::Format::B8G8R8A8_UNORM,
    vk::Format::R8G8B8A8_UNORM,
    vk::Format::A8B8G8R8_UNORM_PACK32,
    vk::Format::A2B10G10R10_UNORM_PACK32,
    vk::Format::A2R10G10B10_UNORM_PACK32,
];

/// The surface's size, or the window's if the swapchain determines the surface's.
pub fn extent(can: &vk::SurfaceCapabilitiesKHR, [width, height]: [u32; 2]) -> vk::Extent2D {
    if can.current_extent.width != u32::MAX {
        return can.current_extent;
    }
    let (min, max) = (can.min_image_extent, can.max_image_extent);
    vk::Extent2D {
        width: width.min(max.width).max(min.width.min(width)),
        height: height.min(max.height).max(min.height.min(height)),
    }
}

pub fn format(there: &[vk::SurfaceFormatKHR]) -> Option<vk::Format> {
    let usual = |format: &vk::Format| {
        let space = vk::ColorSpaceKHR::SRGB_NONLINEAR;
        there.iter().any(|found| found.format == *format && found.color_space == space)
    };
    FORMATS.into_iter().find(usual)
}

/// Presents in step with the display, or as fast as frames come.
pub fn mode(there: &[vk::PresentModeKHR], vsync: bool) -> vk::PresentModeKHR {
    type Mode = vk::PresentModeKHR;
    let fast = [Mode::MAILBOX, Mode::IMMEDIATE];
    // Every surface has FIFO.
    fast.into_iter().find(|mode| !vsync && there.contains(mode)).unwrap_or(Mode::FIFO)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn formats_encode_nothing_twice() {
        let of = |format, color_space| vk::SurfaceFormatKHR { format, color_space };
        let usual = vk::ColorSpaceKHR::SRGB_NONLINEAR;
        let wide = vk::ColorSpaceKHR::EXTENDED_SRGB_LINEAR_EXT;
        let there = [
            of(vk::Format::B8G8R8A8_SRGB, usual),
            of(vk::Format::R8G8B8A8_UNORM, usual),
            of(vk::Format::B8G8R8A8_UNORM, usual),
        ];
        assert_eq!(format(&there), Some(vk::Format::B8G8R8A8_UNORM));
        assert_eq!(format(&there[..2]), Some(vk::Format::R8G8B8A8_UNORM));
        assert_eq!(format(&there[..1]), None);
        assert_eq!(format(&[of(vk::Format::B8G8R8A8_UNORM, wide)]), None);
    }

    #[test]
    fn sizes_and_modes_are_the_surfaces() {
        let size = |width, height| vk::Extent2D { width, height };
        let mut can = vk::SurfaceCapabilitiesKHR { current_extent: size(640, 480), ..Default::default() };
        assert_eq!(extent(&can, [10, 20]), size(640, 480));
        can.current_extent = size(u32::MAX, u32::MAX);
        (can.min_image_extent, can.max_image_extent) = (size(1, 1), size(4096, 15));
        assert_eq!(extent(&can, [10, 20]), size(10, 15));
        assert_eq!(extent(&can, [0, 0]), size(0, 0), "minimised");
        type Mode = vk::PresentModeKHR;
        let there = [Mode::FIFO, Mode::IMMEDIATE, Mode::MAILBOX];
        assert_eq!([mode(&there, true), mode(&there, false)], [Mode::FIFO, Mode::MAILBOX]);
        assert_eq!([mode(&there[..2], false), mode(&there[..1], false)], [Mode::IMMEDIATE, Mode::FIFO]);
    }
}
