//! The layers of AlexNet and VGG16 up to the last features that LPIPS compares.

use crate::error::{Error, Result};

/// A network whose features are compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Network {
    /// AlexNet (Krizhevsky 2014), in torchvision's form.
    AlexNet,
    /// VGG16 without batch normalisation (Simonyan and Zisserman 2015), in torchvision's form.
    Vgg16,
}

/// Operation of a layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LayerKind {
    /// A convolution and its ReLU.
    Convolution,
    /// Max pooling, without padding.
    MaxPool,
}

/// A layer of a network.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Layer {
    /// Index in torchvision's `features`.
    pub index: u32,
    /// Operation of the layer.
    pub kind: LayerKind,
    /// Number of input channels.
    pub inputs: u32,
    /// Number of output channels.
    pub outputs: u32,
    /// Side of the window, input pixels.
    pub size: u32,
    /// Distance between two outputs, input pixels.
    pub stride: u32,
    /// Number of zero rows and columns on each side of the input.
    pub padding: u32,
    /// True if LPIPS compares the output.
    pub is_tap: bool,
}

impl Layer {
    const fn convolution(
        index: u32,
        [inputs, outputs]: [u32; 2],
        [size, stride, padding]: [u32; 3],
        is_tap: bool,
    ) -> Self {
        Self { index, kind: LayerKind::Convolution, inputs, outputs, size, stride, padding, is_tap }
    }

    const fn pool(index: u32, channels: u32, size: u32) -> Self {
        let kind = LayerKind::MaxPool;
        Self { index, kind, inputs: channels, outputs: channels, size, stride: 2, padding: 0, is_tap: false }
    }

    /// Returns the number of outputs along an axis of `inputs` inputs.
    pub(super) fn outputs_of(&self, inputs: u32) -> u32 {
        let padded = inputs + 2 * self.padding;
        if padded < self.size { 0 } else { (padded - self.size) / self.stride + 1 }
    }

    /// Returns the number of outputs along an axis that depend only on the first `known` of `all` inputs.
    pub(super) fn outputs_of_first(&self, known: u32, all: u32) -> u32 {
        if known >= all {
            return self.outputs_of(all);
        }
        let padded = known + self.padding;
        if padded < self.size { 0 } else { (padded - self.size) / self.stride + 1 }
    }
}

const ALEXNET: [Layer; 7] = [
    Layer::convolution(0, [3, 64], [11, 4, 2], true),
    Layer::pool(2, 64, 3),
    Layer::convolution(3, [64, 192], [5, 1, 2], true),
    Layer::pool(5, 192, 3),
    Layer::convolution(6, [192, 384], [3, 1, 1], true),
    Layer::convolution(8, [384, 256], [3, 1, 1], true),
    Layer::convolution(10, [256, 256], [3, 1, 1], true),
];

const VGG16: [Layer; 17] = [
    Layer::convolution(0, [3, 64], [3, 1, 1], false),
    Layer::convolution(2, [64, 64], [3, 1, 1], true),
    Layer::pool(4, 64, 2),
    Layer::convolution(5, [64, 128], [3, 1, 1], false),
    Layer::convolution(7, [128, 128], [3, 1, 1], true),
    Layer::pool(9, 128, 2),
    Layer::convolution(10, [128, 256], [3, 1, 1], false),
    Layer::convolution(12, [256, 256], [3, 1, 1], false),
    Layer::convolution(14, [256, 256], [3, 1, 1], true),
    Layer::pool(16, 256, 2),
    Layer::convolution(17, [256, 512], [3, 1, 1], false),
    Layer::convolution(19, [512, 512], [3, 1, 1], false),
    Layer::convolution(21, [512, 512], [3, 1, 1], true),
    Layer::pool(23, 512, 2),
    Layer::convolution(24, [512, 512], [3, 1, 1], false),
    Layer::convolution(26, [512, 512], [3, 1, 1], false),
    Layer::convolution(28, [512, 512], [3, 1, 1], true),
];

impl Network {
    /// Both networks.
    pub const ALL: [Self; 2] = [Self::AlexNet, Self::Vgg16];

    /// Returns the name.
    pub fn name(self) -> &'static str {
        match self {
            Self::AlexNet => "AlexNet",
            Self::Vgg16 => "VGG16",
        }
    }

    /// Returns the layers, in order.
    pub fn layers(self) -> &'static [Layer] {
        match self {
            Self::AlexNet => &ALEXNET,
            Self::Vgg16 => &VGG16,
        }
    }

    /// Returns the convolutions, in order.
    pub fn convolutions(self) -> impl Iterator<Item = &'static Layer> {
        self.layers().iter().filter(|layer| layer.kind == LayerKind::Convolution)
    }

    /// Returns the five layers with outputs that LPIPS compares, in order.
    pub fn taps(self) -> impl Iterator<Item = &'static Layer> {
        self.layers().iter().filter(|layer| layer.is_tap)
    }

    /// Checks that a picture is large enough for every layer.
    ///
    /// # Errors
    /// [`Error::Argument`] with the minimum size.
    pub fn check_size(self, width: u32, height: u32) -> Result<()> {
        let outputs = |side: u32| self.layers().iter().fold(side, |side, layer| layer.outputs_of(side));
        if outputs(width.min(height)) > 0 {
            return Ok(());
        }
        let min_side = (1..).find(|&side| outputs(side) > 0).unwrap_or(u32::MAX);
        let problem = format!("is {width}x{height} pixels, {} needs {min_side} at least", self.name());
        Err(Error::argument("picture for LPIPS", problem))
    }
}

/// Weights of a network and of LPIPS' heads, in PyTorch's order.
#[derive(Clone, Debug, PartialEq)]
pub struct Weights {
    /// Network of the weights.
    pub network: Network,
    /// Per convolution: weights (output, input, y, x), row-major, and one bias per output.
    pub convolutions: Vec<(Vec<f32>, Vec<f32>)>,
    /// Per tap: one weight per channel.
    pub heads: Vec<Vec<f32>>,
}

impl Weights {
    /// Checks the number of weights.
    ///
    /// # Errors
    /// [`Error::Argument`] naming the layer.
    pub fn check(&self) -> Result<()> {
        let network = self.network;
        let wrong = |what: String| Error::argument(format!("weights of {}", network.name()), what);
        let (layers, taps) = (network.convolutions().count(), network.taps().count());
        if self.convolutions.len() != layers || self.heads.len() != taps {
            return Err(wrong(format!("must be those of {layers} convolutions and {taps} heads")));
        }
        for (layer, (weights, biases)) in network.convolutions().zip(&self.convolutions) {
            let wanted = (layer.outputs * layer.inputs * layer.size * layer.size) as usize;
            if weights.len() != wanted || biases.len() != layer.outputs as usize {
                let index = layer.index;
                return Err(wrong(format!("layer {index} has {wanted} weights, {} biases", layer.outputs)));
            }
        }
        for (index, (tap, head)) in network.taps().zip(&self.heads).enumerate() {
            if head.len() != tap.outputs as usize {
                return Err(wrong(format!("head {index} has {} weights", tap.outputs)));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_may_be_too_small() {
        assert!(Network::AlexNet.check_size(31, 500).is_ok() && Network::Vgg16.check_size(500, 16).is_ok());
        let message = |network: Network, side| network.check_size(side, 99).expect_err("small").to_string();
        assert!(message(Network::AlexNet, 30).contains("30x99 pixels, AlexNet needs 31"));
        assert!(message(Network::Vgg16, 15).contains("15x99 pixels, VGG16 needs 16"));
    }
}
