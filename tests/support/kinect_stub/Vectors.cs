// Writes the test vectors of tests/vectors with the client's encoder: vectors.exe NAME > NAME.bin
using System;
using Mocapella.KinectV2;

public static class Vectors
{
    public static int Main(string[] words)
    {
        var frame = words[0] == "frame_skeleton" ? Skeleton()
            : words[0] == "frame_everything" ? Everything() : Nobody();
        var message = BodyMessage.Encode(frame);
        if (words.Length > 1) message = BodyMessage.Delimited(message);
        using (var output = Console.OpenStandardOutput()) output.Write(message, 0, message.Length);
        return 0;
    }

    private static FrameValues Skeleton()
    {
        var frame = new FrameValues
        {
            Sensor = "front", NodeId = 0x0123456789ABCDEF, Sequence = 2, TimeNs = 66666667, SentNs = 5000000123,
            DepthWidthPx = 512, DepthHeightPx = 424, TiltRad = -0.125f, HeightM = 1.5f,
            HasDepthPx = false, HasOrientations = false, Bodies = new[] { new BodyValues(25), new BodyValues(25) },
        };
        for (int b = 0; b < 2; b++)
        {
            var body = frame.Bodies[b];
            body.TrackingId = 72057594037927937UL + (ulong)b;
            body.IsTracked = 1;
            body.ClippedEdges = (byte)(b == 0 ? 0 : 9);
            for (int j = 0; j < 25; j++)
            {
                body.States[j] = j % 8 == 7 ? BodyValues.NotTracked
                    : j % 8 == 3 ? BodyValues.Inferred : BodyValues.Tracked;
                if (body.States[j] == BodyValues.NotTracked) continue;
                body.PositionsM[3 * j] = (j - 12) / 16f + 2 * b - 1;
                body.PositionsM[3 * j + 1] = (12 - j) / 8f;
                body.PositionsM[3 * j + 2] = 2 + j / 64f;
            }
        }
        return frame;
    }

    private static FrameValues Everything()
    {
        var frame = new FrameValues
        {
            Sensor = "left.2", NodeId = 1, Sequence = 1UL << 40, TimeNs = -1, Topology = "kinect_v1",
            DepthWidthPx = 320, DepthHeightPx = 240, Bodies = new[] { new BodyValues(20) },
        };
        var body = frame.Bodies[0];
        body.TrackingId = ulong.MaxValue;
        body.IsTracked = 1;
        body.ClippedEdges = 15;
        for (int j = 0; j < 19; j++) // the last joint is not tracked
        {
            body.States[j] = BodyValues.Tracked;
            Set(body.PositionsM, j, j / 32f, -j / 32f, 1.25f + j / 128f);
            Set(body.DepthPx, j, 100 + j * 8.5f, 200 - j * 4.25f);
            Set(body.Orientations, j, 0.5f, 0.5f, 0.5f - j % 2, j % 2 - 0.5f);
        }
        Set(body.DepthPx, 5, BodyValues.Missing, BodyValues.Missing);
        float none = BodyValues.Missing;
        Set(body.Orientations, 3, none, none, none, none);
        return frame;
    }

    private static void Set(float[] values, int joint, params float[] one)
    {
        Array.Copy(one, 0, values, joint * one.Length, one.Length);
    }

    private static FrameValues Nobody()
    {
        return new FrameValues { Sensor = "front", NodeId = 0x0123456789ABCDEF };
    }
}
